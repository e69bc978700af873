"""How much places scatter about a smooth map beyond their own standard deviations.

A stripe's edge that crosses a pixel meets whatever the pixel is made of: photosites that are not alike, gaps between them,
display pixels with dark borders. Such an error shifts the place, the farther the wider the footprint, and leaves no residual
in the pixel's own curve. But the map from camera to display is smooth nearly everywhere, so the surest places are compared
with what their neighbours say.
"""

import cv2
import numpy as np
from jaxtyping import Float

WINDOW_PX = 7
PIXELS = 4000
SUREST_SHARE = 0.25
FEWEST_PIXELS = 200
# What neighbours add to their own sd, in units of the surest places': a lone sure neighbour must not decide alone.
NEIGHBOUR_SCALE = 3.0
# Neighbours that leave more of their own surface than this many times the usual show an edge or a fold of the map.
LARGEST_ROUGHNESS = 3.0
# One stray place in a window that is smooth otherwise (light that came another way) must not widen all others.
LARGEST_SQUARE = 25.0
BISECTIONS = 40

Grid = Float[np.ndarray, "rows cols"]


def scatter_beyond(place_px: Grid, sd_px: Grid, scale_px: Grid) -> float:
    """Return the standard deviation that places have beside their own, in units of ``scale_px``.

    The maps hold NaN where there is no place. A quadratic surface is laid through the 7 by 7 neighbours of each of the surest
    places, without the place itself; windows with gaps or folds are left out. What is returned makes the mean square of the
    normalised differences one; 0 where the places' own are large enough, or pixels too few.
    """
    square, variance, scale = _differences(place_px, sd_px, scale_px)
    if len(square) < FEWEST_PIXELS:
        return 0.0

    def too_small(beyond: float) -> bool:
        return bool(np.minimum(square / (variance + beyond * scale**2), LARGEST_SQUARE).mean() > 1.0)

    if not too_small(0.0):
        return 0.0
    low, high = 0.0, float((square / scale**2).mean())
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if too_small(middle) else (low, middle)
    return float(np.sqrt(high))


def _differences(place_px: Grid, sd_px: Grid, scale_px: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the squared differences of the surest places from their neighbours' surface, their variances, and the scales."""
    half = WINDOW_PX // 2
    known = np.isfinite(place_px) & np.isfinite(sd_px) & np.isfinite(scale_px)
    # At the edge of what is seen a map is bent, and pixels see parts of two surfaces.
    whole = cv2.erode(known.astype(np.uint8), np.ones((WINDOW_PX, WINDOW_PX), np.uint8), borderValue=0).astype(bool)
    if np.count_nonzero(whole) < FEWEST_PIXELS:
        return np.empty(0), np.empty(0), np.empty(0)
    sure = np.flatnonzero(whole & (sd_px <= np.quantile(sd_px[whole], SUREST_SHARE)))
    sure = sure[:: max(len(sure) // PIXELS, 1)]
    row, col = np.divmod(sure, place_px.shape[1])
    dy, dx = (one.ravel() for one in np.mgrid[-half : half + 1, -half : half + 1])
    beside = (row[:, None] + dy, col[:, None] + dx)
    typical = float(np.median(sd_px.ravel()[sure]))
    weight = 1 / (sd_px[beside].astype(np.float64) ** 2 + (NEIGHBOUR_SCALE * typical) ** 2)
    weight[:, (dy == 0) & (dx == 0)] = 0.0
    value = place_px[beside] - place_px.ravel()[sure, None]
    design = np.stack([np.ones(len(dx)), dx, dy, dx**2, dx * dy, dy**2], axis=1).astype(np.float64)
    inverse = np.linalg.inv(np.einsum("ps,si,sj->pij", weight, design, design, optimize=True))
    surface = np.einsum("pij,ps,sj->pi", inverse, weight * value, design, optimize=True)
    rough = (weight * (value - surface @ design.T) ** 2).sum(axis=1)
    smooth = rough <= LARGEST_ROUGHNESS**2 * np.median(rough)
    own = sd_px.ravel()[sure].astype(np.float64) ** 2
    return (surface[:, 0] ** 2)[smooth], (own + inverse[:, 0, 0])[smooth], scale_px.ravel()[sure][smooth]
