"""The bias of a window's slopes, which a quadratic polynomial leaves where the surface bends more than that, taken off."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64

from recon.surface.ray_chords import Mask, ScalarMap, VectorMap
from recon.surface.window_means import replace_by_means, weighted_means

# The bias is taken from this many pixels across.
BIAS_WINDOW_PX = 9
# From the measured normals it is taken nearer by: beside a crease it is not that of pixels farther away.
OWN_WINDOW_PX = 5
# Along a rim it changes more slowly than across it.
RIM_WINDOW_PX = 17
# Windows cut at a rim, or by the tile, tell of the bias only where no whole one is near.
CUT_WEIGHT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Slopes along both axes of a tile, and those of the draws of their heights' errors.

    ``variance`` is that of a slope for heights of variance one; 0 for the measured normals, of which there are no draws.
    """

    slope: Float64[np.ndarray, "2 rows cols"]
    drawn: Float32[np.ndarray, "2 draws rows cols"]
    variance: ScalarMap


def own_slopes(normal: VectorMap, mask: Mask) -> Slopes:
    """Return the slopes that the measured normals tell."""
    up = np.where(mask, normal[..., 2], 1.0)
    slope = np.stack([np.where(mask, -normal[..., axis] / up, 0.0) for axis in (0, 1)])
    return Slopes(slope, np.empty((2, 0, *mask.shape), np.float32), np.zeros(mask.shape))


def whole_bias(half_width: int, smaller: int) -> float:
    """Return a window's bias over what it differs by from that of a smaller window (0: the pixel's own normal, without bias).

    A cubic term c p³ gives the slope of the best quadratic polynomial over −h … h the bias c Σp⁴/Σp² = c (3h² + 3h − 1)/5.
    """
    bias = (3 * half_width**2 + 3 * half_width - 1) / 5
    return bias / (bias - ((3 * smaller**2 + 3 * smaller - 1) / 5 if smaller else 0.0))


def without_bias(
    now: Slopes, before: Slopes, trust: ScalarMap, depth_px: ScalarMap, within: Mask, *, half_width: int, smaller: int
) -> tuple[Slopes, Float64[np.ndarray, "2 rows cols"]]:
    """Return the slopes of a window without its bias, and the bias that may be left.

    The bias is ``whole_bias`` times the mean, over the pixels about each, of what the window differs by from the next smaller one
    (``before``), which counts by its ``trust``. What the smaller one does to draws is known, so that they lose the same. From
    measured normals it is not: then nothing is taken off, and all of it is left. Otherwise, left is what that mean itself smooths
    away. Of what is left, noise is not taken off: a bias as large could hide in it.

    Within a window's reach of the rim the bias changes from pixel to pixel, so that those as deep (``depth_px``) tell each other.
    The law holds for whole windows only. What it says of a cut one is as large, but may have the other sign: all of it is left.
    Pixels that are not ``within`` the tile hardly tell: the tile cuts their windows.
    """
    # A window with hardly more places than terms says next to nothing, and would spoil those about it.
    weight = trust / (now.variance + before.variance)
    factor = whole_bias(half_width, smaller)
    change = factor * (now.slope - before.slope)
    if before.drawn.shape[1] < now.drawn.shape[1]:
        return now, weighted_means(change, weight, window_px=OWN_WINDOW_PX)
    weight = np.where(within, weight, CUT_WEIGHT * weight)
    bias = _by_depth(change, weight, depth_px, half_width=half_width)
    left = bias - _by_depth(bias, weight, depth_px, half_width=half_width)
    drawn = _by_depth(np.float32(factor) * (now.drawn - before.drawn), weight, depth_px, half_width=half_width)
    whole = depth_px > half_width
    clear = Slopes(now.slope - whole * bias, now.drawn - whole.astype(np.float32) * drawn, now.variance)
    return clear, np.where(whole, left, bias)


def _by_depth(
    slopes: Float[np.ndarray, "2 *draws rows cols"], weight: ScalarMap, depth_px: ScalarMap, *, half_width: int
) -> Float[np.ndarray, "2 *draws rows cols"]:
    """Return the weighted mean over whole windows about each pixel, and near the rim over those alone that are as deep.

    A cut window has that of the outermost whole ones.
    """
    first, last = half_width + 1, half_width + BIAS_WINDOW_PX // 2
    whole = np.where(depth_px > half_width, weight, 0.0)
    outermost = np.where(depth_px == first, weight, CUT_WEIGHT * weight)
    result = np.empty_like(slopes)
    replace_by_means(slopes, whole, depth_px > last, result, window_px=BIAS_WINDOW_PX)
    replace_by_means(slopes, outermost, depth_px <= first, result, window_px=RIM_WINDOW_PX)
    for depth in range(first + 1, last + 1):
        there = depth_px == depth
        replace_by_means(slopes, np.where(there, weight, 0.0), there, result, window_px=RIM_WINDOW_PX)
    return result
