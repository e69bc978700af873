"""What a person at the terminal reads of a batch."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from types import TracebackType

from rich.console import Console

from recon.batch.batch_record import Batch
from recon.batch.batch_run import Crew
from recon.batch.group_files import TABLE_NAME
from recon.batch.session_status import SessionStatus
from recon.progress import progress_bar
from recon.report.group import GROUP_NAME, GroupRow

NAMES_SHOWN = 5


class BatchTalk:
    """Prints a line for each session that ends, under a bar over all of them."""

    def __init__(self, batch: Batch, sessions: int) -> None:
        self._batch = batch
        self._sessions = sessions
        self._ended = 0
        self._console = Console(markup=False, highlight=False, soft_wrap=True)
        self._stack = ExitStack()

    def __enter__(self) -> "BatchTalk":
        self._step = self._stack.enter_context(progress_bar("sessions", self._sessions))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def begin(self, crew: Crew) -> None:
        """Say how much there is to do, and who does it."""
        left = len(self._batch.sessions) - self._sessions
        besides = f" ({left} more left as they are)" if left else ""
        self._say(f"{counted(self._sessions)}{besides} on {crew.name}")

    def tell(self, name: str, status: SessionStatus) -> None:
        """Print what became of one session."""
        losses = f"; {status.losses()}" if status.losses() else ""
        if status.state == "waiting":
            self._say(f"{name}{losses}; tried again")
            return
        self._ended += 1
        self._step()
        number = f"{self._ended:>{len(str(self._sessions))}}/{self._sessions}"
        if status.state != "done":
            self._say(f"{number} {name}: {status.state.upper()}: {status.fault or 'as asked'}")
            return
        metrics = self._batch.metrics_of(name)
        if metrics is not None:
            took_s = sum(stage.wall_s for stage in metrics.stages)
            self._say(
                f"{number} {name}: {metrics.verdict.grade}, {metrics.funnel.normals} points, {took_s:.1f} s{losses}"
            )

    def stopping(self, running: int) -> None:
        """Say what the first Ctrl-C does, and what another one would."""
        self._say(
            f"stopping: nothing new is begun, {counted(running)} will be finished; Ctrl-C again ends "
            f"{'it' if running == 1 else 'them'} at once"
        )

    def summary(self, rows: Sequence[GroupRow]) -> None:
        """Print what the batch came to and where it is."""
        grades = Counter(row.grade for row in rows)
        counts = ", ".join(
            f"{grades[grade]} {grade}" for grade in ("pass", "check", "fail", "no result") if grades[grade]
        )
        self._say(f"{counted(len(rows))}: {counts}")
        self._say(f"  table: {self._batch.folder / TABLE_NAME}")
        self._say(f"  page: {self._batch.folder / GROUP_NAME}")

    def interrupted(self, statuses: Mapping[str, SessionStatus]) -> None:
        """Say how to go on after an interruption, and what goes on by itself."""
        states = Counter(status.state for status in statuses.values())
        rest = ", ".join(
            f"{states[state]} {state}" for state in ("done", "failed", "stopped", "waiting") if states[state]
        )
        running = [name for name, status in statuses.items() if status.state == "running"]
        if running:
            self._say(f"{listed(running)}: still at work on the cluster; their status.json tells when they end")
        self._say(f"stopped: {rest}; to go on: recon batch --resume --out {self._batch.folder}")

    def failure(self, failed: Sequence[str]) -> str:
        """Return the sentence that names what has no result."""
        return (
            f"{len(failed)} of {counted(len(self._batch.sessions))} failed: {listed(failed)}; see why in "
            f"{self._batch.folder / GROUP_NAME}, mend them, then: recon batch --only failed --out {self._batch.folder}"
        )

    def _say(self, text: str) -> None:
        self._console.print(text)


def counted(sessions: int) -> str:
    """Write a number of sessions."""
    return "1 session" if sessions == 1 else f"{sessions} sessions"


def listed(names: Sequence[str]) -> str:
    """Write some names as a sentence has them, the first few of many.

    Examples
    --------
    >>> listed(["cup"]), listed(["cup", "vase", "ball"]), listed([str(n) for n in range(9)])
    ('cup', 'cup, vase and ball', '0, 1, 2, 3, 4 and 4 more')
    """
    if len(names) > NAMES_SHOWN:
        return f"{', '.join(names[:NAMES_SHOWN])} and {len(names) - NAMES_SHOWN} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
