"""How a camera pixel spreads over the display: the gradient of the coordinate map, by local plane fits."""

import cv2
import numpy as np
from jaxtyping import Bool, Float64

WINDOW_PX = 5
# Where a small window spans less than this many quanta of the places it sees their steps; a larger one is taken.
LARGE_WINDOW_PX = 15
FEWEST_QUANTA = 2.5
# A slope needs a few neighbours, and not all of them in one line.
FEWEST_NEIGHBOURS = 6


def coordinate_gradient(
    place_px: Float64[np.ndarray, "rows cols"], valid: Bool[np.ndarray, "rows cols"], *, quantum_px: float
) -> Float64[np.ndarray, "rows cols 2"]:
    """Return (du/dcol, du/drow) of a coordinate map by least squares over valid neighbours; NaN where too few.

    A plane u = u0 + g·(col, row) is fitted to 5 by 5 pixels about each, or to 15 by 15 where the smaller window sees only a
    few steps of the places; pixels far from their neighbours' median are left out. ``quantum_px`` is how coarse the places
    may be: a step of the sweep is no outlier where pixels are finer than steps.
    """
    filled = np.where(valid, place_px, 0.0)
    median = cv2.medianBlur(filled.astype(np.float32), WINDOW_PX)
    spread = cv2.medianBlur(np.abs(filled - median).astype(np.float32), WINDOW_PX)
    keep = valid & (np.abs(filled - median) <= 6 * spread + 2 * quantum_px)
    small = _plane_slopes(place_px, keep, window_px=WINDOW_PX)
    large = _plane_slopes(place_px, keep, window_px=LARGE_WINDOW_PX)
    stepped = np.abs(large).sum(axis=-1) * WINDOW_PX < FEWEST_QUANTA * quantum_px
    return np.where(stepped[..., None], large, small)


def _plane_slopes(place_px: np.ndarray, keep: np.ndarray, *, window_px: int) -> np.ndarray:
    """Return the slopes of the plane through the kept pixels of each window; NaN where these are too few or in one line."""
    half = window_px // 2
    step = np.arange(-half, half + 1, dtype=np.float64)
    one = np.ones_like(step)

    def total(values: np.ndarray, by_col: np.ndarray, by_row: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(values, cv2.CV_64F, by_col, by_row, borderType=cv2.BORDER_CONSTANT)

    weight = keep.astype(np.float64)
    # Taken from the local median, so that large coordinates do not cost digits.
    value = np.where(keep, place_px, 0.0)
    count = total(weight, one, one)
    x, y = total(weight, step, one), total(weight, one, step)
    xx, yy, xy = total(weight, step**2, one), total(weight, one, step**2), total(weight, step, step)
    v, xv, yv = total(value, one, one), total(value, step, one), total(value, one, step)
    safe = np.maximum(count, 1.0)
    xx, yy, xy = xx - x * x / safe, yy - y * y / safe, xy - x * y / safe
    xv, yv = xv - x * v / safe, yv - y * v / safe
    determinant = xx * yy - xy**2
    good = (count >= FEWEST_NEIGHBOURS) & (determinant > 1e-6)
    scale = np.where(good, determinant, 1.0)
    gradient = np.stack([(yy * xv - xy * yv) / scale, (xx * yv - xy * xv) / scale], axis=-1)
    gradient[~good] = np.nan
    return gradient
