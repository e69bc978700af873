"""Clocks: the real one, a fast one, and a simulated one on which an hour of pumping passes at once.

All implement :class:`drivers.protocols.Clock`. Everything simulated asks its clock and nothing else for the time, so
that a capture behaves the same on each.
"""

import threading
import time


class RealClock:
    """The time of the room: :func:`time.monotonic` and :func:`time.sleep`."""

    def now_s(self) -> float:
        """Seconds since an arbitrary start; never runs backwards."""
        return time.monotonic()

    def sleep_s(self, duration_s: float) -> None:
        """Wait; a duration that is not positive returns at once."""
        if duration_s > 0:
            time.sleep(duration_s)


class SimulatedClock:
    """A clock that moves only when somebody sleeps on it, and then without waiting."""

    def __init__(self) -> None:
        self._now_s = 0.0
        self._lock = threading.Lock()

    def now_s(self) -> float:
        """Seconds slept so far, by everybody together."""
        with self._lock:
            return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        """Move the time on by ``duration_s``; a duration that is not positive changes nothing."""
        if duration_s > 0:
            with self._lock:
                self._now_s += duration_s


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
