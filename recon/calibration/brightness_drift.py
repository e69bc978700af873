"""Whether the display's brightness stays: a straight line through the brightness of one frame over minutes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Samples = Float64[np.ndarray, " photos"]

FEWEST_PHOTOS = 4


@dataclass(frozen=True, slots=True, eq=False)
class BrightnessDrift:
    """Change of brightness as a share a minute, with its standard deviation; ``relative`` is each photo against the mean."""

    time_s: Samples
    relative: Samples
    per_min: float
    per_min_sd: float
    scatter: float

    @property
    def lasted_s(self) -> float:
        """How long it was watched."""
        return float(self.time_s.max() - self.time_s.min())


def fit_drift(time_s: Samples, value: Samples, *, black: float) -> BrightnessDrift:
    """Return how the brightness changed.

    Parameters
    ----------
    time_s, value:
        When each photo was taken, and its mean count.
    black:
        The count of a dark display, which does not drift with its light.

    Raises
    ------
    ValueError
        For fewer than four photos, or where they were all taken at once.
    """
    if time_s.size < FEWEST_PHOTOS or np.ptp(time_s) <= 0:
        raise ValueError(f"{FEWEST_PHOTOS} photos or more are needed, taken one after the other")
    light = value - black
    relative = light / light.mean() - 1
    centred = time_s - time_s.mean()
    slope = float(centred @ relative / (centred @ centred))
    scatter = float(np.sqrt(np.sum((relative - slope * centred) ** 2) / (time_s.size - 2)))
    slope_sd = scatter / float(np.sqrt(centred @ centred))
    return BrightnessDrift(time_s, relative, 60 * slope, 60 * slope_sd, scatter)


def drift_warnings(drift: BrightnessDrift, *, sweep_s: float, largest_share: float = 0.02) -> tuple[str, ...]:
    """Return what to do where the display would change by more than ``largest_share`` during one sweep."""
    change = drift.per_min * sweep_s / 60
    if abs(change) <= largest_share or abs(drift.per_min) < 2 * drift.per_min_sd:
        return ()
    return (
        f"The display {'gains' if change > 0 else 'loses'} {100 * abs(change):.1f} % of its brightness in a sweep of "
        f"{sweep_s / 60:.0f} min: let it warm up for half an hour with a bright picture, and switch off automatic brightness.",
    )
