"""Live quality within a capture: who is told of each sweep, when its verdict is awaited, and what a bad one leads to."""

import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from types import TracebackType
from typing import Self

from rich.console import Console

from recon.sessions.session import SessionWriter
from rig.capture_sections import Live
from rig.capturing.progress import CaptureProgress
from rig.config import RigConfig
from rig.live.live_decoder import LiveDecoder
from rig.live.live_quality import LiveQuality, SweepVerdict
from rig.live.live_status import LiveStatus, finite
from rig.live.status_page import StatusPage
from rig.planning.steps import Step, TakePhoto


@dataclass(frozen=True, slots=True)
class SetVerdict:
    """Axes of a set's sweeps that are good and that were void; ``fault`` is why the capture cannot go on, if so."""

    good: tuple[str, ...]
    void: tuple[str, ...]
    fault: str


class LiveCapture:
    """Keeps decoder, verdicts and page together while it is entered."""

    def __init__(
        self, limits: Live, config: RigConfig, writer: SessionWriter, *, progress: CaptureProgress, console: Console
    ) -> None:
        self._limits = limits
        self._writer = writer
        self._console = console
        self._attempts: Counter[tuple[str, str]] = Counter()
        self._judged: set[tuple[str, str]] = set()
        self._last_photo_s = time.monotonic()
        self._ready_s: float | None = None
        self._stack = ExitStack()
        self.status = LiveStatus(config, progress)
        self._page = StatusPage(self.status.as_json, port=limits.page_port)
        self._decoder = LiveDecoder(writer.folder)
        self._quality = LiveQuality(self._decoder, limits, writer.manifest, on_verdict=self._show, on_news=self._tell)
        self.status.quality = self._quality

    def photo_saved(self, photo: TakePhoto, following: Step | None) -> None:
        """Count a photo; the last one of a sweep sends the sweep to be decoded."""
        self._last_photo_s = time.monotonic()
        self.status.photos += 1
        if photo.sweep not in ("x", "y"):
            return
        ends = not (isinstance(following, TakePhoto) and following.sweep == photo.sweep)
        self.status.photographing = None if ends else (photo.set_name, photo.sweep)
        if ends:
            self._quality.sweep_taken(photo.set_name, photo.sweep)
        else:
            self._quality.poll()

    def judge_set(self, set_name: str, *, on_poll: Callable[[], None]) -> SetVerdict:
        """Wait for the verdicts on a set's two sweeps, journal them, and void the bad ones.

        A sweep that is bad after all its attempts is void as well, so that resuming takes it again.
        """
        for axis in ("x", "y"):
            if (set_name, axis) not in self._quality.verdicts | dict.fromkeys(self._quality.pending()):
                self._quality.sweep_taken(set_name, axis)
        self._quality.wait(on_poll=on_poll)
        found = [
            self._quality.verdicts[key] for key in ((set_name, "x"), (set_name, "y")) if key in self._quality.verdicts
        ]
        for verdict in found:
            if (set_name, verdict.quality.axis) not in self._judged:
                self._record(verdict)
        return SetVerdict(
            good=tuple(verdict.quality.axis for verdict in found if not verdict.reasons),
            void=tuple(verdict.quality.axis for verdict in found if verdict.reasons),
            fault=next(filter(None, map(self._fault, found)), ""),
        )

    def finish(self, *, on_poll: Callable[[], None]) -> None:
        """Say what the four sets come to, and how long after the last photo every sweep was decoded."""
        self._quality.wait(on_poll=on_poll)
        if self._ready_s is not None:
            self._tell(f"the last sweep was decoded {self._ready_s:.1f} s after the last photo")
        if len(self._quality.verdicts) == 2 * len(self._writer.manifest.sets):
            self._quality.ask_for_entry_points()
            self._quality.wait(on_poll=on_poll)

    def _record(self, verdict: SweepVerdict) -> None:
        one = verdict.quality
        if verdict.reasons:
            self._attempts[one.set, one.axis] += 1
            self._writer.reject_sweep(one.set, one.axis, reason="; ".join(verdict.reasons))
            return
        self._judged.add((one.set, one.axis))
        numbers = {name: finite(value) if isinstance(value, float) else value for name, value in asdict(one).items()}
        self._ready_s = round(time.monotonic() - self._last_photo_s, 1)
        self._writer.journal.append(
            "sweep_judged", **numbers, entry_sd_mm=finite(verdict.entry_sd_mm), after_last_photo_s=self._ready_s
        )

    def _fault(self, verdict: SweepVerdict) -> str:
        """Return why the capture ends here: a sweep that is bad after all its attempts."""
        one = verdict.quality
        tried = self._attempts[one.set, one.axis]
        if not verdict.reasons or tried < self._limits.attempts:
            return ""
        times = "once" if tried == 1 else f"{tried} times"
        return (
            f"sweep {one.set} {one.axis} was photographed {times} and is not good enough: {'; '.join(verdict.reasons)}; "
            "mend that and resume, and the sweep is taken again"
        )

    def _show(self, verdict: SweepVerdict) -> None:
        self._console.print(verdict.text(), markup=False)

    def _tell(self, line: str) -> None:
        self.status.add(line)
        self._console.print(line, markup=False)

    def __enter__(self) -> Self:
        self._stack.enter_context(self._decoder)
        self._stack.enter_context(self._page)
        self._console.print(f"how it goes: {self._page.address}", markup=False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()
