"""Pixels that an edge of the light leaves less than half of: they look at the object's rim, and their centre sees nothing.

What such a pixel shows is the mean over its lit part, which lies on the other side of the edge than its centre: a straight edge
through a pixel darkens its centre where it leaves less than half of the light.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

HALF = 0.5
# An edge is at most this far from the first dark pixel, since lens and sensor blur it.
EDGE_REACH_PX = 2
# The light of a whole pixel is read from lit ones farther than that from the dark, in a window of this size.
WINDOW_PX = 9
FEWEST_WHOLE = 3
BAND_ROWS = 256


def half_seen_of(
    light: Float[np.ndarray, " pixels"], pixels: Int[np.ndarray, " pixels"], lit: Bool[np.ndarray, "rows cols"]
) -> Bool[np.ndarray, "rows cols"]:
    """Return what :func:`less_than_half_seen` does, a band of rows at a time, of the light of pixels in ascending order."""
    rows, cols = lit.shape
    # So far away a pixel can be dark that keeps another from being whole, whose light would count.
    margin = EDGE_REACH_PX + WINDOW_PX // 2
    half = np.zeros(lit.shape, dtype=bool)
    for low in range(0, rows, BAND_ROWS):
        above, below = max(low - margin, 0), min(low + BAND_ROWS + margin, rows)
        first, last = np.searchsorted(pixels, np.array([above * cols, below * cols], dtype=pixels.dtype))
        if first == last:
            continue
        near = np.full((below - above, cols), np.nan, dtype=light.dtype)
        near.ravel()[pixels[first:last] - above * cols] = light[first:last]
        found = less_than_half_seen(near, lit[above:below])
        half[low : low + BAND_ROWS] = found[low - above :][:BAND_ROWS]
    return half


def less_than_half_seen(
    light: Float[np.ndarray, "rows cols"], lit: Bool[np.ndarray, "rows cols"]
) -> Bool[np.ndarray, "rows cols"]:
    """Return which lit pixels beside dark ones get less than half of the light of the whole pixels near them.

    ``light`` is what each pixel gets of a stripe that would cover all that it sees, in counts, NaN where that is not known. Where
    no whole pixel is near, nothing is said.
    """
    reach = np.ones((2 * EDGE_REACH_PX + 1,) * 2, np.uint8)
    # Beyond the photo it is not dark.
    at_edge = lit & cv2.dilate((~lit).astype(np.uint8), reach, borderType=cv2.BORDER_CONSTANT, borderValue=0).astype(
        bool
    )
    whole = lit & ~at_edge & np.isfinite(light)
    row, col = np.nonzero(at_edge & np.isfinite(light))
    half = WINDOW_PX // 2
    near = np.full([size + 2 * half for size in light.shape], np.nan, dtype=light.dtype)
    np.copyto(near[half:-half, half:-half], light, where=whole)
    windows = np.lib.stride_tricks.sliding_window_view(near, (WINDOW_PX, WINDOW_PX))[row, col].reshape(-1, WINDOW_PX**2)
    known = np.isfinite(windows).sum(axis=1) >= FEWEST_WHOLE
    result = np.zeros(light.shape, dtype=bool)
    row, col = row[known], col[known]
    result[row, col] = light[row, col] < HALF * np.nanmedian(windows[known], axis=1)
    return result
