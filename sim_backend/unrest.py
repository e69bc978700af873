"""What should not happen in a simulated world, and does when a test asks for it: pushes, slips, dimmer light, ripples, noise."""

import math
import threading
from dataclasses import dataclass, replace

from sim_backend.disturbance import QUIET, Disturbance

# Ripples that have sunk to exp(-5), 0.7 % of their first slope, are called gone.
DECAY = 5.0


@dataclass(frozen=True, slots=True)
class Ripples:
    """What the liquid's surface does after it was moved: waves of this slope at first, gone after ``lasts_s``."""

    slope: float
    lasts_s: float

    def slope_after(self, elapsed_s: float) -> float:
        """Return the largest slope ``elapsed_s`` after the flow ended."""
        return 0.0 if elapsed_s >= self.lasts_s else self.slope * math.exp(-DECAY * elapsed_s / self.lasts_s)


class Unrest:
    """Keeps what is disturbed; a new one is quiet, and photos of the same scene are the same bytes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lasting = QUIET
        self._ripples: Ripples | None = None
        self._liquid_moved_s: float | None = None
        self._exposures: int | None = None

    def disturb(self, disturbance: Disturbance) -> None:
        """Push, shift or dim things from now on."""
        with self._lock:
            self._lasting = disturbance

    def ripple_after_flows(self, ripples: Ripples) -> None:
        """Let the liquid ripple whenever it has been moved."""
        with self._lock:
            self._ripples = ripples

    def renew_noise(self, *, first: int = 1) -> None:
        """Give every photo from now on noise of its own, as a camera does; ``first`` numbers the first of them."""
        with self._lock:
            self._exposures = first - 1

    def liquid_moved(self, at_s: float) -> None:
        """Take down that liquid flowed until ``at_s``."""
        with self._lock:
            self._liquid_moved_s = at_s

    def at(self, now_s: float) -> Disturbance:
        """Return what is disturbed in a photo that is taken now."""
        with self._lock:
            now = self._lasting
            if self._exposures is not None:
                self._exposures += 1
                now = replace(now, exposure=self._exposures)
            if self._ripples is None or self._liquid_moved_s is None:
                return now
            elapsed_s = now_s - self._liquid_moved_s
            slope = self._ripples.slope_after(elapsed_s)
            return replace(now, ripple_slope=slope, ripple_time_s=elapsed_s) if slope > 0 else now
