"""How a camera pixel spreads over the display: the gradient of the coordinate map, by local plane fits."""

from itertools import product

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

WINDOW_PX = 5
# Where a small window spans less than this many quanta of the places it sees their steps; a larger one is taken.
LARGE_WINDOW_PX = 15
FEWEST_QUANTA = 2.5
# A slope needs a few neighbours, and not all of them in one line.
FEWEST_NEIGHBOURS = 6
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
        if not valid[top:bottom, left:right].any():
            continue
        # A tile sees the neighbours of its own neighbours, so that it is none the worse for being one.
        above, before = max(top - NEIGHBOURHOOD_PX, 0), max(left - NEIGHBOURHOOD_PX, 0)
        part = (slice(above, bottom + NEIGHBOURHOOD_PX), slice(before, right + NEIGHBOURHOOD_PX))
        inner = (slice(top - above, bottom - above), slice(left - before, right - before))
        for number, slopes in enumerate(_tile_gradient(place_px[part], valid[part], quantum_px=quantum_px)):
            gradient[top:bottom, left:right, number] = slopes[inner]
    return gradient


def _tile_gradient(place_px: np.ndarray, valid: np.ndarray, *, quantum_px: float) -> tuple[np.ndarray, np.ndarray]:
    filled = np.where(valid, place_px, 0.0).astype(np.float64)
    median = cv2.medianBlur(filled.astype(np.float32), WINDOW_PX)
    off = np.abs(filled - median)
    spread = cv2.medianBlur(off.astype(np.float32), WINDOW_PX)
    keep = valid & (off <= 6 * spread + 2 * quantum_px)
    value = np.where(keep, filled, 0.0)
    by_col, by_row = _plane_slopes(value, keep, window_px=LARGE_WINDOW_PX)
    stepped = (np.abs(by_col) + np.abs(by_row)) * WINDOW_PX < FEWEST_QUANTA * quantum_px
    if not stepped.all():
        small_by_col, small_by_row = _plane_slopes(value, keep, window_px=WINDOW_PX)
        by_col, by_row = np.where(stepped, by_col, small_by_col), np.where(stepped, by_row, small_by_row)
    return by_col, by_row


def _plane_slopes(value: np.ndarray, keep: np.ndarray, *, window_px: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes of the plane through the kept pixels of each window; NaN where these are too few or in one line.

    ``value`` is zero where it is not kept.
    """
    half = window_px // 2
    step = np.arange(-half, half + 1, dtype=np.float64)
    one = np.ones_like(step)

    def total(values: np.ndarray, by_col: np.ndarray, by_row: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(values, -1, by_col, by_row, borderType=cv2.BORDER_CONSTANT).astype(
            np.float64, copy=False
        )

    # Sums of small whole numbers, which single precision holds exactly.
    weight = keep.astype(np.float32)
    count = total(weight, one, one)
    x, y = total(weight, step, one), total(weight, one, step)
    xx, yy, xy = total(weight, step**2, one), total(weight, one, step**2), total(weight, step, step)
    v, xv, yv = total(value, one, one), total(value, step, one), total(value, one, step)
    # From here on about the mean of each window.
    share = 1 / np.maximum(count, 1.0)
    x_mean, y_mean = x * share, y * share
    xx -= x * x_mean
    yy -= y * y_mean
    xy -= x * y_mean
    xv -= x_mean * v
    yv -= y_mean * v
    determinant = xx * yy - xy**2
    good = (count >= FEWEST_NEIGHBOURS) & (determinant > 1e-6)
    scale = np.where(good, determinant, np.nan)
    return (yy * xv - xy * yv) / scale, (xx * yv - xy * xv) / scale
