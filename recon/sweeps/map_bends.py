"""How the map from camera to display and its light change across each pixel, by quadratic surfaces through windows about it.

Over a window the terms 1, x, y, x² − m, x y and y² − m, with m the mean of x², are at right angles to each other: each follows
from one weighted sum.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from recon.compiled import compiled

# A window holds where its places scatter no more than so many of their sds about its surface, and the light no more than so
# much of itself. Compressed photos leave errors that no pixel's sd tells.
LARGEST_ROUGHNESS = 2.0
SUREST_PX = 0.01
LARGEST_FLICKER = 0.1

SmallGrid = Float32[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]
Terms = Float32[np.ndarray, "7 rows cols"]


def map_bends(
    place_px: SmallGrid, sd_px: SmallGrid, fading: SmallGrid, there: Mask, *, window_px: int
) -> tuple[Terms, Mask]:
    """Return the surface through every window that is whole and holds, and which do; elsewhere terms say nothing.

    The terms are slopes by column and row, bends by column, both and row, and how the light fades by column and row.

    Parameters
    ----------
    place_px, sd_px, fading
        Places with their sds, and the logarithm of the light; 0 where nothing is ``there``.
    """
    whole = cv2.erode(there.astype(np.uint8), np.ones((window_px, window_px), np.uint8), borderValue=0)
    terms, rough = np.empty((7, *there.shape), np.float32), np.zeros((2, *there.shape), np.float32)
    by_row = np.empty((5, *there.shape), np.float32)
    _write_rows(place_px, fading, window_px // 2, by_row)
    _write_terms(by_row, place_px, sd_px, fading, whole, window_px // 2, terms, rough)
    holds = whole.view(bool)
    for one in rough:
        holds &= cv2.blur(one, (window_px, window_px), borderType=cv2.BORDER_CONSTANT) <= 0
    return terms, holds


@compiled
def _write_rows(place: np.ndarray, fading: np.ndarray, half: int, by_row: np.ndarray) -> None:
    """Write sums along rows: of places evenly, by x and by x² − m, of the light's logarithm evenly and by x."""
    rows, cols = place.shape
    mean_square = np.float32(half * (half + 1) / 3)
    for row in range(rows):
        by_row[:, row, :] = np.float32(0)
        for step in range(-half, half + 1):
            x = np.float32(step)
            near = slice(half + step, cols - half + step)
            _add(place[row, near], np.float32(1), by_row[0, row, half : cols - half])
            _add(place[row, near], x, by_row[1, row, half : cols - half])
            _add(place[row, near], x * x - mean_square, by_row[2, row, half : cols - half])
            _add(fading[row, near], np.float32(1), by_row[3, row, half : cols - half])
            _add(fading[row, near], x, by_row[4, row, half : cols - half])


@compiled
def _write_terms(
    by_row: np.ndarray,
    place: np.ndarray,
    sd: np.ndarray,
    fading: np.ndarray,
    whole: np.ndarray,
    half: int,
    terms: np.ndarray,
    rough: np.ndarray,
) -> None:
    """Write the terms of windows, and for whole ones by how much squares of what they leave of pixels are above their limits."""
    rows, cols = place.shape
    window = 2 * half + 1
    mean_square = np.float32(half * (half + 1) / 3)
    one, two, squares = np.float32(1), np.float32(2), np.float32(window * window) * mean_square
    bends = np.float32(0)
    for step in range(-half, half + 1):
        bends += np.float32(window) * (np.float32(step) ** 2 - mean_square) ** 2
    pixels = np.float32(window * window)
    # What a place keeps of its own error beside the surface through its window.
    kept = one - one / pixels - two * mean_square**2 / bends
    largest_rough, largest_flicker = kept * np.float32(LARGEST_ROUGHNESS**2), np.float32(LARGEST_FLICKER**2)
    surest = np.float32(SUREST_PX**2)
    even_sum, light_sum, left = np.empty(cols, np.float32), np.empty(cols, np.float32), np.empty(cols, np.float32)
    for row in range(half, rows - half):
        terms[:, row, :] = np.float32(0)
        even_sum[:], light_sum[:] = np.float32(0), np.float32(0)
        for step in range(-half, half + 1):
            y, near = np.float32(step), row + step
            bend = y * y - mean_square
            _add(by_row[1, near], one / squares, terms[0, row])
            _add(by_row[0, near], y / squares, terms[1, row])
            _add(by_row[2, near], two / bends, terms[2, row])
            _add(by_row[1, near], y * pixels / (squares * squares), terms[3, row])
            _add(by_row[0, near], two * bend / bends, terms[4, row])
            _add(by_row[4, near], one / squares, terms[5, row])
            _add(by_row[3, near], y / squares, terms[6, row])
            _add(by_row[0, near], one / pixels, even_sum)
            _add(by_row[3, near], one / pixels, light_sum)
        _add(terms[2, row], np.float32(-0.5) * mean_square, even_sum)
        _add(terms[4, row], np.float32(-0.5) * mean_square, even_sum)
        for col in range(cols):
            left[col] = place[row, col] - even_sum[col]
        for col in range(cols):
            found = left[col] * left[col] / (sd[row, col] * sd[row, col] + surest) - largest_rough
            rough[0, row, col] = found if whole[row, col] else np.float32(0)
        for col in range(cols):
            left[col] = fading[row, col] - light_sum[col]
        for col in range(cols):
            found = left[col] * left[col] - largest_flicker
            rough[1, row, col] = found if whole[row, col] else np.float32(0)


@compiled
def _add(values: np.ndarray, weight: np.float32, total: np.ndarray) -> None:
    for col in range(len(total)):
        total[col] += weight * values[col]
