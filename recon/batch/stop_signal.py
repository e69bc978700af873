"""Ctrl-C and its like, counted instead of obeyed, so that a batch can make an orderly end."""

import signal
import threading
from types import FrameType, TracebackType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignal:
    """Counts signals while it is entered: ``asked`` = 1 begins nothing new, 2 ends what runs."""

    def __init__(self) -> None:
        self.asked = 0
        self._before: dict[signal.Signals, object] = {}

    def _handle(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002  (signal's own signature)
        self.asked += 1

    def __enter__(self) -> "StopSignal":
        # Python lets only the main thread receive signals; elsewhere the caller sets ``asked``.
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._handle) for number in SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal.signal itself returned
        self._before = {}
