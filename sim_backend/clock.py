"""Two clocks: the real one, and a simulated one on which an hour of pumping passes at once.

Both implement :class:`drivers.protocols.Clock`. Everything simulated asks its clock and nothing else for the time, so
that a capture behaves the same on either.
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
