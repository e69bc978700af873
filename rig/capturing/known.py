"""What is known of a session beyond its plan: photos that are whole, ranges that were found, sweeps that were judged."""

from dataclasses import dataclass, field

from recon.sessions.journal import JOURNAL_NAME, SweepRange, read_journal
from recon.sessions.session import Session
from rig.capturing.session_check import SessionCheck
from rig.planning.steps import PhotoKey

SweepKey = tuple[str, str]  # set, axis


@dataclass(slots=True, eq=False)
class Known:
    """Grows while a capture runs; a plan is made from it."""

    done: set[PhotoKey] = field(default_factory=set)
    ranges: dict[SweepKey, SweepRange] = field(default_factory=dict)
    judged: set[SweepKey] = field(default_factory=set)

    def void(self, sweep: SweepKey) -> None:
        """Forget the photos of a sweep and what was thought of it."""
        self.done -= {key for key in self.done if key[:2] == sweep}
        self.judged.discard(sweep)


def known_of(session: Session, found: SessionCheck) -> Known:
    """Return what a session knows: photos that were found whole on the disk, and what the journal says of its sweeps."""
    judged: set[SweepKey] = set()
    for entry in read_journal(session.folder / JOURNAL_NAME):
        if entry["event"] == "sweep_judged":
            judged.add((str(entry.get("set")), str(entry.get("axis"))))
        elif entry["event"] == "sweep_rejected":
            judged.discard((str(entry.get("set")), str(entry.get("sweep"))))
    return Known(set(found.whole), dict(session.ranges), judged)
