"""How far a capture is: a bar with the remaining time on a terminal, silence elsewhere."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn


class CaptureProgress:
    """Shows what happens now and how long the rest will take.

    Work is measured in planned seconds, so that an hour of photos and a minute of pumping share one bar; the
    remaining time follows from how fast planned seconds really pass.
    """

    def __init__(self, console: Console, *, total_s: float) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task: TaskID = self._progress.add_task("starting", total=max(total_s, 1e-9))

    def tell(self, text: str) -> None:
        """Say what happens now."""
        self._progress.update(self._task, description=text)

    def advance(self, planned_s: float) -> None:
        """Count a step as done."""
        self._progress.advance(self._task, planned_s)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()
