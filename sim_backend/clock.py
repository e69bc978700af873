"""Clocks: the real one, a fast one, and a simulated one on which an hour of pumping passes at once.

All implement :class:`drivers.protocols.Clock`. Everything simulated asks its clock and nothing else for the time, so
that a capture behaves the same on each.
"""

import threading
import time
from collections.abc import Callable


class RealClock:
    """The time of the room: :func:`time.monotonic` and :func:`time.sleep`; ``on_move`` hears the time after each sleep."""

    def __init__(self, *, on_move: Callable[[float], None] = lambda now_s: None) -> None:  # noqa: ARG005
        self._on_move = on_move

    def now_s(self) -> float:
        """Seconds since an arbitrary start; never runs backwards."""
        return time.monotonic()

    def sleep_s(self, duration_s: float) -> None:
        """Wait; a duration that is not positive returns at once."""
        if duration_s > 0:
            time.sleep(duration_s)
            self._on_move(self.now_s())


class SimulatedClock:
    """A clock that moves only when somebody sleeps on it, and then without waiting; ``on_move`` hears the new time."""

    def __init__(self, start_s: float = 0.0, *, on_move: Callable[[float], None] = lambda now_s: None) -> None:  # noqa: ARG005
        self._now_s = start_s
        self._on_move = on_move
        self._lock = threading.Lock()

    def now_s(self) -> float:
        """The start and the seconds slept since, by everybody together."""
        with self._lock:
            return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        """Move the time on by ``duration_s``; a duration that is not positive changes nothing."""
        if duration_s > 0:
            with self._lock:
                self._now_s += duration_s
                self._on_move(self._now_s)


class FastClock:
    """The time of the room, ``speed`` times as fast: for programs that keep their own time beside an emulator."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Seconds since this clock was made, ``speed`` for each second of the room."""
        return self._speed * (time.monotonic() - self._start_s)

    def sleep_s(self, duration_s: float) -> None:
        """Wait; a duration that is not positive returns at once."""
        if duration_s > 0:
            time.sleep(duration_s / self._speed)
