"""What every experiment is told, and the list of them by name."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from recon.study.study_result import StudyFigure, StudyTable


@dataclass(frozen=True, slots=True)
class StudySize:
    """How large an experiment is made. The paper: 1,024 camera columns, 500 rounds; 3,888 columns for the real objects."""

    columns: int | None = None  # None: what the experiment itself suggests
    rounds: int | None = None
    seed: int = 0

    def columns_or(self, suggested: int) -> int:
        """Return the camera's columns."""
        return suggested if self.columns is None else self.columns

    def rounds_or(self, suggested: int) -> int:
        """Return the number of rounds with noise drawn anew."""
        return suggested if self.rounds is None else self.rounds


@dataclass(frozen=True, slots=True)
class Findings:
    """What an experiment saw: the setting in words, tables, and curves."""

    setting: str
    tables: tuple[StudyTable, ...]
    figures: tuple[StudyFigure, ...] = ()


Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Experiment:
    """One experiment of the paper; ``run(folder, size, tell)`` simulates into ``folder`` and says how far it is."""

    name: str
    title: str
    run: Callable[[Path, StudySize, Tell], Findings]


def named(experiments: Sequence[Experiment], name: str) -> Experiment | None:
    """Return the experiment of this name, or None."""
    return next((one for one in experiments if one.name == name), None)
