"""Depth jumps that no pair of neighbours shows, and many along an edge do.

The surface through all pixels bridges a jump that is small beside the noise of one distance; what the distances then leave of it
changes its level there, in pixel after pixel. A level on each side of an edge, and a slope that both share, is fitted to what
is left over a window that the edge halves; chance would make the two levels as different as asked once in the largest photos.
"""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import binary_propagation, maximum_filter1d

# Pixels on each side of the edge, and along it; so much of each side must be known.
DEEP_PX, LONG_PX = 6, 9
LEAST_SHARE = 0.15
# A jump begins where its level is this many sd, and goes on along its edge down to so many.
JUMP_SD, GOES_ON_SD = 6.5, 2.5
# So many of the levels are noise in any case; their size tells what it is, also where neighbours share it.
TAIL, TAIL_SD = 0.8, 1.2816
# A lone outlier is no level.
LARGEST_SD = 4.0
# From one row to the next an edge moves by at most this, and it goes on over so many rows that noise hides: one pair that is not
# cut holds two sheets together.
STAIR_PX = 2
HIDDEN_PX = 4

Map = Float64[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]


def long_jumps(left_mm: Map, precision: Map, *, threads: int = 1) -> tuple[Map, Map]:
    """Return by how many sd the depth jumps from pixels to their right-hand and lower neighbours; 0 where it does not.

    NaN where an edge between columns moves from one row to the next, or the other way round: neighbours tell of such a pair.

    Parameters
    ----------
    left_mm
        Measured distances less those of a surface through all of them.
    precision
        One over the variance of each measured distance; 0 where there is none.
    threads
        With more than one, edges between columns and edges between rows are sought at the same time.
    """
    with ThreadPoolExecutor(min(threads, 2)) as pool:
        across, down = pool.map(levels, (left_mm, left_mm.T), (precision, precision.T))
    down = down.T
    both = np.abs(np.concatenate([across.ravel(), down.ravel()]))
    both = both[both > 0]
    # Neither standard deviations that promise too much nor errors that neighbours share are a reason to cut.
    scale = max(1.0, float(np.quantile(both, TAIL)) / TAIL_SD) if len(both) else 1.0
    with ThreadPoolExecutor(min(threads, 2)) as pool:
        right, below = pool.map(_edges, (across / scale, down.T / scale))
    below = below.T
    found = []
    for edge, level, stairs in ((right, across, _stairs(below.T).T), (below, down, _stairs(right))):
        size = np.maximum(np.abs(level) / scale, np.finfo(float).tiny)
        found.append(np.where(edge, size, np.where(stairs, np.nan, 0.0)))
    return found[0], found[1]


def levels(left_mm: Map, precision: Map) -> Map:
    """Return the jump from each pixel to its right-hand neighbour, in its own sd; 0 where one side knows little."""
    sd = np.sqrt(np.divide(1.0, precision, out=np.zeros_like(precision), where=precision > 0))
    held = np.clip(left_mm, -LARGEST_SD * sd, LARGEST_SD * sd)
    before, after = (_sums(precision, precision * held, side) for side in (-1, 1))
    weight = np.minimum(before[0], after[0])
    typical = float(np.median(precision[precision > 0])) if (precision > 0).any() else 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        place, level = (after[k] / after[0] - before[k] / before[0] for k in (1, 3))
        spread, along = (
            sum(side[k] - side[1] * side[j] / side[0] for side in (before, after)) for k, j in ((2, 1), (4, 3))
        )
        # The slope that both sides share takes its part of the difference of their means.
        jump = level - along / spread * place
        found = jump / np.sqrt(1 / before[0] + 1 / after[0] + place**2 / spread)
    return np.where((weight > LEAST_SHARE * DEEP_PX * LONG_PX * typical) & np.isfinite(found), found, 0.0)


def _sums(weight: Map, weighted: Map, side: int) -> tuple[Map, ...]:
    """Sum over the half of each edge's window on one side: weight · 1, p, p² and value · 1, p, by the place p from the edge."""
    offset = np.arange(1 - DEEP_PX, 1) if side < 0 else np.arange(1, DEEP_PX + 1)
    along = np.ones(LONG_PX)
    found = []
    for values, power in ((weight, 0), (weight, 1), (weight, 2), (weighted, 0), (weighted, 1)):
        across = np.zeros(2 * DEEP_PX + 1)
        across[DEEP_PX + offset] = (offset - 0.5) ** power
        held = np.ascontiguousarray(values)
        found.append(cv2.sepFilter2D(held, cv2.CV_64F, across, along, borderType=cv2.BORDER_CONSTANT))
    return tuple(found)


def _edges(level: Map) -> Mask:
    """Return the places where a jump to the right is the largest about it, along edges that are sure somewhere."""
    size = np.abs(level)
    largest = size >= maximum_filter1d(size, 2 * DEEP_PX + 1, axis=1, mode="constant")
    goes_on = largest & (size > GOES_ON_SD)
    near = np.ones((3, 2 * STAIR_PX + 1), dtype=bool)
    seed = goes_on & (size > JUMP_SD)
    return _without_gaps(binary_propagation(seed, structure=near, mask=_without_gaps(goes_on)) if seed.any() else seed)


def _without_gaps(edge: Mask) -> Mask:
    """Join the ends of edges that go on a few rows below."""
    whole = edge.copy()
    for row, col in np.argwhere(edge):
        window = edge[row + 1 : row + 2 + HIDDEN_PX, max(col - STAIR_PX, 0) : col + STAIR_PX + 1]
        below, beside = np.nonzero(window)
        if not len(below) or below[0] == 0:
            continue
        other = beside[below == below[0]] + max(col - STAIR_PX, 0)
        end = other[np.abs(other - col).argmin()]
        steps = np.arange(1, below[0] + 1)
        whole[row + steps, np.rint(col + (end - col) * steps / (below[0] + 1)).astype(int)] = True
    return whole


def _stairs(right: Mask) -> Mask:
    """Return between which pixels and their lower neighbours an edge between columns moves from one row to the next."""
    below = np.zeros_like(right)
    for row, col in np.argwhere(right[:-1]):
        low = max(col - STAIR_PX, 0)
        next_row = np.flatnonzero(right[row + 1, low : col + STAIR_PX + 1])
        for other in next_row + low:
            below[row, min(col, other) + 1 : max(col, other) + 1] = True
    return below
