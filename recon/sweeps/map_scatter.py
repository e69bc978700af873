"""How much places scatter about a smooth map beyond their own standard deviations.

A stripe's edge that crosses a pixel meets whatever the pixel is made of: photosites that are not alike, gaps between
them, display pixels with dark borders. Such an error shifts the place and leaves no residual in the pixel's own curve. But the
map from camera to display is smooth nearly everywhere, so the surest places are compared with what their neighbours say.
"""

import numpy as np
from jaxtyping import Float

WINDOW_PX = 7
PIXELS = 4000
SUREST_SHARE = 0.25
FEWEST_PIXELS = 200
# What neighbours add to their own sd, in units of the surest places': a lone sure neighbour must not decide alone.
NEIGHBOUR_SCALE = 3.0
BISECTIONS = 40
# Median of the square of a standard normal variable; edges and jumps of the map, where differences mean nothing, leave it alone.
MEDIAN_SQUARE = 0.4549

Grid = Float[np.ndarray, "rows cols"]


def scatter_beyond_px(place_px: Grid, sd_px: Grid) -> float:
    """Return the standard deviation that places have beside their own, from maps with NaN where there is no place.

    A quadratic surface is laid through the 7 by 7 neighbours of each of the surest places, without the place itself. What is
    returned makes the median square of the normalised differences that of a standard normal variable; 0 where the places'
    own are large enough, or pixels too few.
    """
    square, variance = _differences(place_px, sd_px)
    if len(square) < FEWEST_PIXELS:
        return 0.0

    def too_small(beyond: float) -> bool:
        return bool(np.median(square / (variance + beyond)) > MEDIAN_SQUARE)

    if not too_small(0.0):
        return 0.0
    low, high = 0.0, float(square.mean())
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if too_small(middle) else (low, middle)
    return float(np.sqrt(high))


def _differences(place_px: Grid, sd_px: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Return the squared differences of the surest places from their neighbours' surface, and the variances promised."""
    half = WINDOW_PX // 2
    known = np.isfinite(place_px) & np.isfinite(sd_px)
    inner = known.copy()
    inner[:half], inner[-half:], inner[:, :half], inner[:, -half:] = False, False, False, False
    if np.count_nonzero(inner) < FEWEST_PIXELS:
        return np.empty(0), np.empty(0)
    sure = np.flatnonzero(inner & (sd_px <= np.quantile(sd_px[inner], SUREST_SHARE)))
    sure = sure[:: max(len(sure) // PIXELS, 1)]
    row, col = np.divmod(sure, place_px.shape[1])
    dy, dx = (one.ravel() for one in np.mgrid[-half : half + 1, -half : half + 1])
    beside = (row[:, None] + dy, col[:, None] + dx)
    typical = float(np.median(sd_px.ravel()[sure]))
    weight = np.where(
        known[beside], 1 / (sd_px[beside].astype(np.float64) ** 2 + (NEIGHBOUR_SCALE * typical) ** 2), 0.0
    )
    weight[:, (dy == 0) & (dx == 0)] = 0.0
    value = np.where(known[beside], place_px[beside] - place_px.ravel()[sure, None], 0.0)
    design = np.stack([np.ones(len(dx)), dx, dy, dx**2, dx * dy, dy**2], axis=1).astype(np.float64)
    normal = np.einsum("ps,si,sj->pij", weight, design, design, optimize=True)
    enough = np.linalg.cond(normal) < 1e8
    inverse = np.linalg.inv(normal[enough])
    surface = np.einsum("pi,ps,si->p", inverse[:, 0], (weight * value)[enough], design, optimize=True)
    own = sd_px.ravel()[sure][enough].astype(np.float64) ** 2
    return surface**2, own + inverse[:, 0, 0]
