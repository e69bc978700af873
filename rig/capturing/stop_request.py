"""Signals, made orderly: Ctrl-C once asks for a pause at the next safe moment, twice stops at once."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Literal, Self

from rig.errors import CaptureStopped

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
Boundary = Literal["photo", "sweep", "set"]
BOUNDARIES: tuple[Boundary, ...] = ("photo", "sweep", "set")


class StopRequest:
    """Catches signals while it is entered; the sequencer calls :meth:`check` and :meth:`passed` wherever stopping is safe.

    ``pause_after`` is where the operator wants a pause, None for nowhere.
    """

    def __init__(self, on_request: Callable[[], None] = lambda: None, *, pause_after: Boundary | None = None) -> None:
        self.pause_after = pause_after
        self._on_request = on_request
        self._requested: signal.Signals | None = None
        self._at_once = False
        self._resting = False
        self._before: dict[signal.Signals, object] = {}

    @property
    def may_go_on(self) -> bool:
        """Whether whoever asked may want to go on: Ctrl-C is a person at the terminal, the other signals are not."""
        return self._requested in (None, signal.SIGINT)

    def check(self) -> None:
        """Raise :class:`~rig.errors.CaptureStopped` once a stop was asked for."""
        if self._requested is not None:
            raise CaptureStopped("stopped as asked")

    def passed(self, boundary: Boundary) -> None:
        """Raise :class:`~rig.errors.CaptureStopped` where the operator wants a pause: the end of a photo, sweep or set."""
        self.check()
        if self.pause_after is not None and BOUNDARIES.index(boundary) >= BOUNDARIES.index(self.pause_after):
            raise CaptureStopped(f"paused after this {boundary} as asked")

    def forget(self) -> None:
        """Take back the request: the operator goes on."""
        self._requested = None

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Let the first interrupt stop at once while a person is asked, since nothing else happens meanwhile."""
        self.check()
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False

    @contextmanager
    def resting(self) -> Iterator[None]:
        """Let no signal keep pump and stage from being stopped; these calls have deadlines of their own."""
        self._resting = True
        try:
            yield
        finally:
            self._resting = False

    def _handle(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002  (signal's own signature)
        again = self._requested is not None
        if not again:
            self._requested = signal.Signals(number)
        if self._resting:
            return
        if again or self._at_once:
            raise KeyboardInterrupt
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
