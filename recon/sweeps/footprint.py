"""How a camera pixel spreads over the display: the gradient of the coordinate map, by local plane fits."""

from itertools import product

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from recon.compiled import compiled

WINDOW_PX = 5
# Where a small window spans less than this many quanta of the places it sees their steps; a larger one is taken.
LARGE_WINDOW_PX = 15
FEWEST_QUANTA = 2.5
# Pixels whose places are more than so many times the usual distance from their neighbours' median are left out.
LARGEST_SPREADS = 6
# A slope needs a few neighbours, and not all of them in one line.
FEWEST_NEIGHBOURS = 6
LEAST_DETERMINANT = 1e-6
# Maps are gone through tile by tile, each with what its pixels' own neighbours see: two medians and the large window.
TILE_PX = 256
NEIGHBOURHOOD_PX = 2 * (WINDOW_PX // 2) + LARGE_WINDOW_PX // 2


def coordinate_gradient(
    place_px: Float[np.ndarray, "rows cols"], valid: Bool[np.ndarray, "rows cols"], *, quantum_px: float
) -> Float32[np.ndarray, "rows cols 2"]:
    """Return (du/dcol, du/drow) of a coordinate map by least squares over valid neighbours; NaN where too few.

    A plane u = u0 + g·(col, row) is fitted to 5 by 5 pixels about each, or to 15 by 15 where the smaller window sees only a
    few steps of the places; pixels far from their neighbours' median are left out. ``quantum_px`` is how coarse the places
    may be: a step of the sweep is no outlier where pixels are finer than steps.
    """
    rows, cols = place_px.shape
    gradient = np.full((rows, cols, 2), np.nan, dtype=np.float32)
    for top, left in product(range(0, rows, TILE_PX), range(0, cols, TILE_PX)):
        bottom, right = min(top + TILE_PX, rows), min(left + TILE_PX, cols)
        # A tile sees the neighbours of its own neighbours, so that it is none the worse for being one.
        above, before = max(top - NEIGHBOURHOOD_PX, 0), max(left - NEIGHBOURHOOD_PX, 0)
        part = (slice(above, bottom + NEIGHBOURHOOD_PX), slice(before, right + NEIGHBOURHOOD_PX))
        if np.count_nonzero(valid[part]) < FEWEST_NEIGHBOURS:
            continue
        inner = (slice(top - above, bottom - above), slice(left - before, right - before))
        for number, slopes in enumerate(_tile_gradient(place_px[part], valid[part], quantum_px=quantum_px)):
            gradient[top:bottom, left:right, number] = slopes[inner]
    return gradient


def _tile_gradient(place_px: np.ndarray, valid: np.ndarray, *, quantum_px: float) -> Float64[np.ndarray, "2 rows cols"]:
    filled = np.where(valid, place_px, place_px.dtype.type(0))
    median = cv2.medianBlur(filled.astype(np.float32, copy=False), WINDOW_PX)
    value, off, keep = filled.astype(np.float64), np.empty_like(median), np.empty(valid.shape, dtype=bool)
    write_distances(value, median, off)
    spread = cv2.medianBlur(off, WINDOW_PX)
    keep_near(value, np.ascontiguousarray(valid), median, spread, 2 * quantum_px, keep)
    slopes = _plane_slopes(value, keep, window_px=LARGE_WINDOW_PX)
    # Where the larger window has too few pixels, or all in one line, the smaller one has as well.
    if sees_steps_enough(slopes, FEWEST_QUANTA * quantum_px):
        small = _plane_slopes(value, keep, window_px=WINDOW_PX)
        take_smaller(slopes, small, FEWEST_QUANTA * quantum_px)
    return slopes


def _plane_slopes(value: np.ndarray, keep: np.ndarray, *, window_px: int) -> Float64[np.ndarray, "2 rows cols"]:
    """Return the slopes of the plane through the kept pixels of each window; NaN where these are too few or in one line.

    ``value`` is zero where it is not kept.
    """
    slopes = np.full((2, *value.shape), np.nan)
    write_slopes(value, keep, window_px // 2, slopes)
    return slopes


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
def sees_steps_enough(slopes: np.ndarray, quanta: float) -> bool:
    """Return whether some small window sees so many quanta of the places."""
    some = False
    for row in range(np.uintp(slopes.shape[1])):
        for col in range(np.uintp(slopes.shape[2])):
            some |= (abs(slopes[0, row, col]) + abs(slopes[1, row, col])) * WINDOW_PX >= quanta
    return some


@compiled
def take_smaller(slopes: np.ndarray, small: np.ndarray, quanta: float) -> None:
    """Take the slopes of the smaller windows that see so many quanta of the places."""
    for row in range(np.uintp(slopes.shape[1])):
        for col in range(np.uintp(slopes.shape[2])):
            if (abs(slopes[0, row, col]) + abs(slopes[1, row, col])) * WINDOW_PX >= quanta:
                slopes[0, row, col], slopes[1, row, col] = small[0, row, col], small[1, row, col]


@compiled
def write_slopes(value: np.ndarray, keep: np.ndarray, half: int, slopes: np.ndarray) -> None:
    """Write by column and by row [2, rows, cols] the slopes of the planes through the kept pixels of windows about each.

    Sums run along with the window, first down the columns and then along each row. Places in single precision leave double
    precision room for them, so that what is added and taken away again leaves nothing behind.
    """
    rows, cols = value.shape
    # Of each column: pixels, rows, squares of rows, values, rows times values.
    column = np.zeros((5, cols))
    window = np.zeros(9)
    for bottom in range(rows + half):
        for sign, row in ((1.0, bottom), (-1.0, bottom - 2 * half - 1)):
            if 0 <= row < rows:
                for col in range(cols):
                    if keep[row, col]:
                        column[0, col] += sign
                        column[1, col] += sign * row
                        column[2, col] += sign * row * row
                        column[3, col] += sign * value[row, col]
                        column[4, col] += sign * row * value[row, col]
        if bottom < half:
            continue
        window[:] = 0.0
        for right in range(cols + half):
            for sign, col in ((1.0, right), (-1.0, right - 2 * half - 1)):
                if 0 <= col < cols and column[0, col] > 0.0:
                    for moment in range(5):
                        window[moment] += sign * column[moment, col]
                    window[5] += sign * col * column[0, col]
                    window[6] += sign * col * col * column[0, col]
                    window[7] += sign * col * column[1, col]
                    window[8] += sign * col * column[3, col]
            count, y, yy, v, yv = window[0], window[1], window[2], window[3], window[4]
            if right < half or count < FEWEST_NEIGHBOURS:
                continue
            # About the mean of the window, and times the number of its pixels: all but the last two are whole numbers.
            x = window[5]
            xx, yy, xy = count * window[6] - x * x, count * yy - y * y, count * window[7] - x * y
            xv, yv = count * window[8] - x * v, count * yv - y * v
            determinant = xx * yy - xy * xy
            if determinant > LEAST_DETERMINANT * count * count:
                slopes[0, bottom - half, right - half] = (yy * xv - xy * yv) / determinant
                slopes[1, bottom - half, right - half] = (xx * yv - xy * xv) / determinant
