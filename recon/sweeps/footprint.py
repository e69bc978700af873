"""How a camera pixel spreads over the display: the gradient of the coordinate map, by local plane fits."""

from itertools import product

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from recon.compiled import compiled
from recon.sweeps.window_planes import FEWEST_NEIGHBOURS, window_planes

WINDOW_PX = 5
# Where a small window spans less than this many quanta of the places it sees their steps; a larger one is taken.
LARGE_WINDOW_PX = 15
FEWEST_QUANTA = 2.5
# Where a plane through the larger window leaves less than that (rms, in quanta) the map is even, and that window is taken up to
# twice as many: quanta draw the slopes of small windows by a tenth, those of large ones by a hundredth.
EVEN_QUANTA, LARGEST_LEFT = 5.0, 0.35
# Pixels whose places are more than so many times the usual distance from their neighbours' median are left out.
LARGEST_SPREADS = 6
# Maps are gone through tile by tile, each with what its pixels' own neighbours see: two medians and the large window.
TILE_PX = 256
NEIGHBOURHOOD_PX = 2 * (WINDOW_PX // 2) + 2 * (LARGE_WINDOW_PX // 2)
# An edge of the map lies where places so many pixels apart differ by more than a quantum a pixel and one for its steps: where the
# larger window is taken, the map is flatter than half of that.
EDGE_REACH_PX = 3
# Where a map only bends, a window on one side leaves less too, but not so far less, and its slopes are those of another place.
FAR_LESS = 0.25


def coordinate_gradient(
    place_px: Float[np.ndarray, "rows cols"], valid: Bool[np.ndarray, "rows cols"], *, quantum_px: float
) -> tuple[Float32[np.ndarray, "rows cols 2"], Bool[np.ndarray, "rows cols"]]:
    """Return (du/dcol, du/drow) of a coordinate map by least squares over valid neighbours; NaN where too few.

    A plane u = u0 + g·(col, row) is fitted to 5 by 5 pixels about each, or to 15 by 15 where the smaller window sees only a
    few steps of the places; beside it, where such a large window tells it and the map is even over all of that. Pixels far from
    their neighbours' median are left out. ``quantum_px`` is how coarse the places
    may be: a step of the sweep is no outlier where pixels are finer than steps. Where an edge goes through a window, one that has
    the pixel at its border or corner is taken, so that the gradient is that of the pixel's own side.
    """
    rows, cols = place_px.shape
    gradient, even = np.full((rows, cols, 2), np.nan, dtype=np.float32), np.zeros((rows, cols), dtype=bool)
    for top, left in product(range(0, rows, TILE_PX), range(0, cols, TILE_PX)):
        bottom, right = min(top + TILE_PX, rows), min(left + TILE_PX, cols)
        # A tile sees the neighbours of its own neighbours, so that it is none the worse for being one.
        above, before = max(top - NEIGHBOURHOOD_PX, 0), max(left - NEIGHBOURHOOD_PX, 0)
        part = (slice(above, bottom + NEIGHBOURHOOD_PX), slice(before, right + NEIGHBOURHOOD_PX))
        if not _some_window_tells(valid[part]):
            continue
        inner = (slice(top - above, bottom - above), slice(left - before, right - before))
        slopes, level = _tile_gradient(place_px[part], valid[part], quantum_px=quantum_px)
        gradient[top:bottom, left:right] = np.moveaxis(slopes, 0, -1)[inner]
        even[top:bottom, left:right] = level[inner]
    return gradient, even


def _some_window_tells(valid: Bool[np.ndarray, "rows cols"]) -> bool:
    """Return whether some window holds enough pixels: where it is dark, noise lights one here and there."""
    if np.count_nonzero(valid) < FEWEST_NEIGHBOURS:
        return False
    window = (LARGE_WINDOW_PX, LARGE_WINDOW_PX)
    number = cv2.boxFilter(valid.astype(np.uint8), cv2.CV_8U, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return int(number.max()) >= FEWEST_NEIGHBOURS


def _tile_gradient(
    place_px: np.ndarray, valid: np.ndarray, *, quantum_px: float
) -> tuple[Float64[np.ndarray, "2 rows cols"], Bool[np.ndarray, "rows cols"]]:
    filled = np.where(valid, place_px, place_px.dtype.type(0))
    median = cv2.medianBlur(filled.astype(np.float32, copy=False), WINDOW_PX)
    value, off, keep = filled.astype(np.float64), np.empty_like(median), np.empty(valid.shape, dtype=bool)
    write_distances(value, median, off)
    spread = cv2.medianBlur(off, WINDOW_PX)
    keep_near(value, np.ascontiguousarray(valid), median, spread, 2 * quantum_px, keep)
    planes = window_planes(value, keep, window_px=LARGE_WINDOW_PX)
    slopes, cut = planes[:2].copy(), np.zeros(keep.shape, dtype=np.uint8)
    even = planes[3] <= (LARGEST_LEFT * quantum_px) ** 2
    if has_edges(value, keep, quantum_px):
        edge = np.zeros(keep.shape, dtype=np.uint8)
        mark_edges(value, keep, quantum_px, edge)
        near = cv2.dilate(edge, np.ones((LARGE_WINDOW_PX, LARGE_WINDOW_PX), dtype=np.uint8))
        write_one_sided(value, keep, near, LARGE_WINDOW_PX // 2, planes, slopes)
        mark_cut(value, keep, edge, slopes, quantum_px, cut)
    # Where the larger window has too few pixels, or all in one line, the smaller one has as well.
    if sees_steps_enough(planes, slopes, FEWEST_QUANTA * quantum_px):
        small = window_planes(value, keep, window_px=WINDOW_PX)
        steeper = small[:2].copy()
        write_one_sided(value, keep, cut, WINDOW_PX // 2, small, steeper)
        take_smaller(slopes, planes, steeper, quantum_px, even)
    return slopes, even


@compiled
def write_distances(value: np.ndarray, median: np.ndarray, off: np.ndarray) -> None:
    """Write how far the places of a tile [rows, cols] are from their neighbours' median."""
    rows, cols = value.shape
    for row in range(np.uintp(rows)):
        for col in range(np.uintp(cols)):
            off[row, col] = abs(value[row, col] - median[row, col])


@compiled
def keep_near(
    value: np.ndarray, valid: np.ndarray, median: np.ndarray, spread: np.ndarray, tolerance: float, keep: np.ndarray
) -> None:
    """Write which places of a tile are near their neighbours' median, and set the others to zero."""
    least, times = np.float32(tolerance), np.float32(LARGEST_SPREADS)
    rows, cols = value.shape
    for row in range(np.uintp(rows)):
        for col in range(np.uintp(cols)):
            near = abs(value[row, col] - median[row, col]) <= times * spread[row, col] + least
            keep[row, col] = near & valid[row, col]
            value[row, col] = value[row, col] if keep[row, col] else 0.0


@compiled
def sees_steps(planes: np.ndarray, slopes: np.ndarray, row: int, col: int, quanta: float) -> bool:
    """Return whether a pixel's small window sees so many quanta of the places, by the window about it or that on its own side."""
    own = abs(slopes[0, row, col]) + abs(slopes[1, row, col])
    about = abs(planes[0, row, col]) + abs(planes[1, row, col])
    return (own * WINDOW_PX >= quanta) | (about * WINDOW_PX >= quanta)


@compiled
def sees_steps_enough(planes: np.ndarray, slopes: np.ndarray, quanta: float) -> bool:
    """Return whether some small window sees so many quanta of the places."""
    some = False
    for row in range(np.uintp(slopes.shape[1])):
        for col in range(np.uintp(slopes.shape[2])):
            some |= sees_steps(planes, slopes, row, col, quanta)
    return some


@compiled
def take_smaller(slopes: np.ndarray, planes: np.ndarray, small: np.ndarray, quantum: float, even: np.ndarray) -> None:
    """Take the slopes of the ``small`` windows that see enough quanta of the places, which are ``even`` by no larger one then.

    Not where the larger window on the pixel's own side is flat and the smaller one says the same, which tells it less well, nor
    where the map is even.
    """
    for row in range(np.uintp(slopes.shape[1])):
        for col in range(np.uintp(slopes.shape[2])):
            apart = abs(small[0, row, col] - slopes[0, row, col]) + abs(small[1, row, col] - slopes[1, row, col])
            own = abs(slopes[0, row, col]) + abs(slopes[1, row, col])
            flat = (own * WINDOW_PX < FEWEST_QUANTA * quantum) & (apart * WINDOW_PX < quantum)
            better = flat | (even[row, col] & (own * WINDOW_PX < EVEN_QUANTA * quantum))
            if sees_steps(planes, slopes, row, col, FEWEST_QUANTA * quantum) & (not better):
                slopes[0, row, col], slopes[1, row, col] = small[0, row, col], small[1, row, col]
                even[row, col] = False


@compiled
def has_edges(value: np.ndarray, keep: np.ndarray, quantum: float) -> bool:
    """Return whether there is an edge anywhere: most tiles have none, and to look without marking takes far less time."""
    rows, cols = value.shape
    some = False
    for step in range(1, EDGE_REACH_PX + 1):
        largest = (step + 1) * quantum
        for row in range(np.uintp(rows)):
            for col in range(np.uintp(max(cols - step, 0))):
                kept = keep[row, col] & keep[row, col + np.uintp(step)]
                some |= kept & (abs(value[row, col + np.uintp(step)] - value[row, col]) > largest)
        for row in range(np.uintp(max(rows - step, 0))):
            for col in range(np.uintp(cols)):
                kept = keep[row, col] & keep[row + np.uintp(step), col]
                some |= kept & (abs(value[row + np.uintp(step), col] - value[row, col]) > largest)
    return some


@compiled
def mark_edges(value: np.ndarray, keep: np.ndarray, quantum: float, edge: np.ndarray) -> None:
    """Mark the kept pixels on both sides of every edge."""
    rows, cols = value.shape
    for row in range(rows):
        for col in range(cols):
            if not keep[row, col]:
                continue
            for step in range(1, EDGE_REACH_PX + 1):
                for r, c in ((row, col + step), (row + step, col)):
                    kept = r < rows and c < cols and keep[r, c]
                    if kept and abs(value[r, c] - value[row, col]) > (step + 1) * quantum:
                        edge[row, col] = edge[r, c] = 1


@compiled
def mark_cut(
    value: np.ndarray, keep: np.ndarray, edge: np.ndarray, slopes: np.ndarray, quantum: float, cut: np.ndarray
) -> None:
    """Mark the pixels whose smaller window holds both sides of an edge that is none of a map which is merely steep.

    There the places differ by more than the slopes at both pixels tell.
    """
    rows, cols = value.shape
    half = WINDOW_PX // 2
    for row in range(rows):
        for col in range(cols):
            if not (keep[row, col] and edge[row, col]):
                continue
            for step in range(1, EDGE_REACH_PX + 1):
                for axis, r, c in ((0, row, col + step), (1, row + step, col)):
                    if r < rows and c < cols and keep[r, c]:
                        change = value[r, c] - value[row, col]
                        off = min(abs(change - step * slopes[axis, row, col]), abs(change - step * slopes[axis, r, c]))
                        if off > (step + 1) * quantum:
                            cut[max(r - half, 0) : row + half + 1, max(c - half, 0) : col + half + 1] = 1


@compiled
def write_one_sided(
    value: np.ndarray,
    keep: np.ndarray,
    near: np.ndarray,
    half: int,
    planes: np.ndarray,
    slopes: np.ndarray,
) -> None:
    """Write into ``slopes`` those of a window beside the pixel, wherever an edge goes through the one about it (``near``).

    Of the windows that have the pixel at a border or corner the one counts that leaves least, with the pixel's own square, if
    that is far less than what the window about the pixel leaves. Few pixels may lie on one step of the places, of which a level
    plane leaves nothing: half of what a corner of the window about the pixel holds must be there.
    """
    rows, cols = value.shape
    fewest = (half + 1) ** 2 / 2
    for row in range(rows):
        for col in range(cols):
            if not near[row, col] or np.isnan(planes[3, row, col]):
                continue
            own = planes[2, row, col] - value[row, col] if keep[row, col] else 0.0
            least = FAR_LESS * (planes[3, row, col] + own**2)
            for r in (row - half, row, row + half):
                for c in (col - half, col, col + half):
                    if 0 <= r < rows and 0 <= c < cols and planes[4, r, c] >= fewest:
                        there = planes[2, r, c] + planes[0, r, c] * (col - c) + planes[1, r, c] * (row - r)
                        own = there - value[row, col] if keep[row, col] else 0.0
                        left = planes[3, r, c] + own**2
                        if left < least:
                            least = left
                            slopes[0, row, col] = planes[0, r, c]
                            slopes[1, row, col] = planes[1, r, c]
