"""What is left of ripples and of a step in a map of heights."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Values = Float64[np.ndarray, " values"]

# Rows that are judged together: what they have in common by the surface's smoothness is in one part.
ROWS_A_PART = 8
# Edges are looked at in bins of this width, this far to each side, and levelled where they are farther off than that.
BIN_PX = 0.25
REACH_PX = 12.0
LEVEL_FROM_PX = 6.0
# With less of the step left than this, there is nothing to have a width.
LEAST_STEP = 0.1


@dataclass(frozen=True, slots=True)
class Transfer:
    """Height found over true height, with its standard deviation from parts of the picture."""

    ratio: float
    sd: float


@dataclass(frozen=True, slots=True)
class Edge:
    """A step as it was found: its height over the true one, where it rises from 10 % to 90 %, and how far it overshoots.

    ``overshoot`` is the larger of the excursions beyond the two levels within the reach, as a share of the step.
    """

    ratio: float
    width_px: float
    overshoot: float


@dataclass(frozen=True, slots=True, eq=False)
class Ripples:
    """Heights found and true, on some of the pixels of one photo; NaN where there is none or where it does not count."""

    found_mm: Float64[np.ndarray, "rows cols"]
    true_mm: Float64[np.ndarray, "rows cols"]


def height_transfer(seen: Sequence[Ripples]) -> Transfer:
    """Project heights onto the true ripples: Σ found · true / Σ true², once a smooth trend is taken off both.

    The trend is a quadratic polynomial over a photo's pixels. The standard deviation is a jackknife's, over groups of 8 rows.

    Examples
    --------
    >>> column = np.tile(np.arange(60.0), (16, 1))
    >>> ripple = np.sin(2 * np.pi * column / 6)
    >>> height_transfer([Ripples(0.7 * ripple + 0.3 * column, ripple)]).ratio.__round__(6)
    0.7
    """
    parts = np.concatenate([_parts(one) for one in seen]) if seen else np.zeros((0, 2))
    parts = parts[parts[:, 1] > 0]
    if len(parts) < 2:
        return Transfer(np.nan, np.nan)
    together, own = parts.sum(axis=0)
    without = (together - parts[:, 0]) / (own - parts[:, 1])
    count = len(parts)
    sd = np.sqrt((count - 1) / count * ((without - without.mean()) ** 2).sum())
    return Transfer(float(together / own), float(sd))


def _parts(ripples: Ripples) -> Float64[np.ndarray, "parts 2"]:
    """Return Σ found · true and Σ true² of each group of rows, without trend."""
    row, column = np.nonzero(np.isfinite(ripples.found_mm) & np.isfinite(ripples.true_mm))
    if not len(row):
        return np.zeros((0, 2))
    x, y = (2 * (place - place.mean()) / max(float(np.ptp(place)), 1.0) for place in (column, row))
    trend = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    heights = np.stack([ripples.found_mm[row, column], ripples.true_mm[row, column]], axis=1)
    found, true = (heights - trend @ np.linalg.lstsq(trend, heights, rcond=None)[0]).T
    part = row // ROWS_A_PART
    return np.stack([np.bincount(part, found * true), np.bincount(part, true * true)], axis=1)


def edge_of(offset_px: Values, found_mm: Values, *, step_mm: float) -> Edge:
    """Return the edge of pixels that look so many pixels to the right of a step up.

    Heights are averaged in bins of a quarter of a pixel, and the levels are medians from 6 px on. With less than a tenth of the
    step left, width and overshoot are NaN.
    """
    middles = np.arange(-REACH_PX, REACH_PX, BIN_PX) + BIN_PX / 2
    bins = np.floor((offset_px + REACH_PX) / BIN_PX).astype(np.int64)
    inside = (bins >= 0) & (bins < len(middles)) & np.isfinite(found_mm)
    count = np.bincount(bins[inside], minlength=len(middles))
    total = np.bincount(bins[inside], found_mm[inside], minlength=len(middles))
    low, high = (
        np.median(found_mm[inside & (side * offset_px > LEVEL_FROM_PX)])
        if (inside & (side * offset_px > LEVEL_FROM_PX)).any()
        else np.nan
        for side in (-1, 1)
    )
    if not count.all() or not high - low > LEAST_STEP * step_mm:
        return Edge(float((high - low) / step_mm), np.nan, np.nan)
    rise = (total / count - low) / (high - low)
    width_px = _crossing(middles, rise, 0.9) - _crossing(-middles[::-1], 1 - rise[::-1], 0.9, sign=-1)
    return Edge(
        ratio=float((high - low) / step_mm),
        width_px=float(width_px),
        overshoot=float(max(rise.max() - 1, -rise.min(), 0.0)),
    )


def _crossing(place: Values, rise: Values, level: float, *, sign: int = 1) -> float:
    """Return where ``rise`` first reaches ``level`` once it has passed one half for good from the left."""
    start = int(np.flatnonzero(rise < 0.5)[-1]) if (rise < 0.5).any() else 0
    after = start + int(np.argmax(rise[start:] >= level))
    if after == 0 or rise[after] < level:
        return np.nan
    low, high = rise[after - 1], rise[after]
    return sign * float(place[after - 1] + (level - low) / (high - low) * (place[after] - place[after - 1]))
