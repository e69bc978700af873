"""How far a capture is: a bar with the remaining time on a terminal, silence elsewhere."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn


@dataclass(frozen=True, slots=True)
class Where:
    """What happens now, the share of the plan that is done, and the seconds left as far as they can be told."""

    text: str
    share: float
    remaining_s: float | None


class CaptureProgress:
    """Shows what happens now and how long the rest will take.

    Work is measured in planned seconds, so that an hour of photos and a minute of pumping share one bar; the
    remaining time follows from how fast planned seconds really pass.
    """

    def __init__(self, console: Console) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task: TaskID = self._progress.add_task("starting", total=None)
        self._advanced_s = 0.0

    def plan(self, left_s: float) -> None:
        """Take over a new plan: how many planned seconds are left."""
        self._progress.update(self._task, total=max(self._advanced_s + left_s, 1e-9))

    def tell(self, text: str) -> None:
        """Say what happens now."""
        self._progress.update(self._task, description=text)

    def say(self, text: str) -> None:
        """Leave a sentence on the screen, above the bar."""
        self._progress.console.print(text, markup=False)

    def advance(self, planned_s: float) -> None:
        """Count a step as done."""
        self._advanced_s += planned_s
        self._progress.advance(self._task, planned_s)

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Take the bar away while a person reads and answers."""
        self._progress.stop()
        try:
            yield
        finally:
            self._progress.start()

    def where(self) -> Where:
        """Say how far the capture is; may be asked from another thread."""
        task = self._progress.tasks[0]
        return Where(task.description, (task.percentage or 0.0) / 100, task.time_remaining)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()
