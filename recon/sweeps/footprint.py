"""How a camera pixel spreads over the display: the gradient of the coordinate map, by local plane fits."""

import cv2
import numpy as np
from jaxtyping import Bool, Float64

WINDOW_PX = 5
# A slope needs a few neighbours, and not all of them in one line.
FEWEST_NEIGHBOURS = 6


def coordinate_gradient(
    place_px: Float64[np.ndarray, "rows cols"], valid: Bool[np.ndarray, "rows cols"], *, quantum_px: float
) -> Float64[np.ndarray, "rows cols 2"]:
    """Return (du/dcol, du/drow) of a coordinate map by least squares over 5 by 5 valid neighbours; NaN where too few.

    A weighted plane u = u0 + g·(col, row) is fitted about each pixel; pixels far from their neighbours' median are left out.
    ``quantum_px`` is how coarse the places may be: a step of the sweep is no outlier where pixels are finer than steps.
    """
    filled = np.where(valid, place_px, 0.0)
    median = cv2.medianBlur(filled.astype(np.float32), WINDOW_PX)
    spread = cv2.medianBlur(np.abs(filled - median).astype(np.float32), WINDOW_PX)
    keep = valid & (np.abs(filled - median) <= 6 * spread + quantum_px)
    half = WINDOW_PX // 2
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
