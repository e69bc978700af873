"""Ctrl-C, made orderly: once asks the capture to stop at the next safe moment, twice stops at once."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Self

from rig.errors import CaptureStopped

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopRequest:
    """Catches interrupts while it is entered; the sequencer calls :meth:`check` wherever stopping is safe."""

    def __init__(self, on_request: Callable[[], None] = lambda: None) -> None:
        self._on_request = on_request
        self._requested = False
        self._at_once = False
        self._before: dict[signal.Signals, object] = {}

    def check(self) -> None:
        """Raise :class:`~rig.errors.CaptureStopped` once a stop was asked for."""
        if self._requested:
            raise CaptureStopped("stopped as asked")

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Let the first interrupt stop at once while a person is asked, since nothing else happens meanwhile."""
        self.check()
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False

    def _handle(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002  (signal's own signature)
        if self._requested or self._at_once:
            raise KeyboardInterrupt
        self._requested = True
        self._on_request()

    def __enter__(self) -> Self:
        # Python lets only the main thread receive signals; elsewhere (a test, a service) the caller stops us.
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._handle) for number in SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal.signal itself returned
        self._before = {}
