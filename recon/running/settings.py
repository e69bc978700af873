"""What a reconstruction may be told."""

from dataclasses import asdict, dataclass, field
from pathlib import Path

from recon.method import Limits, Method, ThinForm


@dataclass(frozen=True, slots=True)
class Settings:
    """What ``recon run`` may be told.

    ``threads`` = 0 takes every core; without a ``calibration`` the session's own ``calibration.json`` counts, if it has one.
    ``registration``: method ``full`` measures how the display slipped between air and liquid, and corrects its poses.
    ``integration``: the form in which a thin object's normals become a surface; without one, the method's own.
    ``force`` makes everything anew, whatever earlier runs have kept.
    ``board`` = False leaves the session's own photos of a board out.
    """

    method: Method = "full"
    limits: Limits = field(default_factory=Limits)
    threads: int = 0
    calibration: Path | None = None
    registration: bool = True
    board: bool = True
    integration: ThinForm | None = None
    force: bool = False

    def result_parts(self) -> dict[str, object]:
        """Return all that changes a result, for its hash; a calibration counts by what is in it, not by its name."""
        beside = ("threads", "calibration", "force")
        return {name: value for name, value in asdict(self).items() if name not in beside}
