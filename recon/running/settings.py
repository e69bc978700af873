"""What a reconstruction may be told."""

from dataclasses import dataclass, field
from pathlib import Path

from recon.reconstruct import Limits
from recon.sweeps.correspondence import Method


@dataclass(frozen=True, slots=True)
class Settings:
    """What ``recon run`` may be told.

    ``threads`` = 0 takes every core; without a ``calibration`` the session's own ``calibration.json`` counts, if it has one.
    ``registration``: method ``full`` measures how the display slipped between air and liquid, and corrects its poses.
    """

    method: Method = "full"
    limits: Limits = field(default_factory=Limits)
    threads: int = 0
    calibration: Path | None = None
    registration: bool = True
