"""The bias of a window's slopes, which a quadratic polynomial leaves where the surface bends more than that, taken off."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Float32, Float64

from recon.surface.ray_chords import Mask, ScalarMap, VectorMap
from recon.surface.window_means import replace_by_means, weighted_means

# The bias is taken from this many pixels across.
BIAS_WINDOW_PX = 9
# Along a rim it changes more slowly than across it.
RIM_WINDOW_PX = 17
# How it changes with the distance from the rim is told by the rings over so many pixels, if they are no less apart than this.
SLOPE_WINDOW_PX, LEAST_SPREAD_PX2 = 5, 0.1
# What is left of it is told as a mean square over so many pixels across, several of which are independent.
LEFT_WINDOW_PX = 33
# So many draws tell the noise in it over as many pixels.
LEFT_DRAWS = 4
# It falls with the depth inside the surface, quickly near the rim: from one of these depths to the next it is alike.
LEFT_DEPTHS_PX = (*range(1, 11), 12, 14, 17, 21, 26, 33, np.inf)
# Windows cut at a rim, or by the tile, tell of the bias only where no whole one is near.
CUT_WEIGHT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Slopes along both axes of a tile, and those of the draws of their heights' errors.

    ``variance`` is that of a slope for heights of variance one; 0 for those of the measured normals.
    """

    slope: Float64[np.ndarray, "2 rows cols"]
    drawn: Float32[np.ndarray, "2 draws rows cols"]
    variance: ScalarMap


@dataclass(frozen=True, slots=True, eq=False)
class ClearSlopes:
    """Slopes as they were ``fitted`` and ``clear`` of their bias, and the mean square of the tilt by what may be left of it."""

    fitted: Slopes
    clear: Slopes
    left_squared: ScalarMap


def own_slopes(normal: VectorMap, turn: Float32[np.ndarray, "3 draws rows cols"], mask: Mask) -> ClearSlopes:
    """Return the slopes that the measured normals tell, which have no bias, and those of draws of their ``turn`` by noise."""
    up = np.where(mask, normal[..., 2], 1.0)
    slope = np.stack([np.where(mask, -normal[..., axis] / up, 0.0) for axis in (0, 1)])
    # Of n_p / n_up the differential.
    drawn = -(turn[:2] + slope[:, None].astype(np.float32) * turn[2]) / up.astype(np.float32)
    own = Slopes(slope, drawn, np.zeros(mask.shape))
    return ClearSlopes(own, own, np.zeros(mask.shape))


def whole_bias(half_width: int, smaller: int) -> float:
    """Return a window's bias over what it differs by from that of a smaller window (0: the pixel's own normal, without bias).

    A cubic term c p³ gives the slope of the best quadratic polynomial over −h … h the bias c Σp⁴/Σp² = c (3h² + 3h − 1)/5.
    """
    bias = (3 * half_width**2 + 3 * half_width - 1) / 5
    return bias / (bias - ((3 * smaller**2 + 3 * smaller - 1) / 5 if smaller else 0.0))


def without_bias(
    now: Slopes,
    before: ClearSlopes,
    trust: ScalarMap,
    depth_px: ScalarMap,
    straight_px: ScalarMap,
    within: Mask,
    *,
    half_width: int,
    smaller: int,
) -> tuple[Slopes, Float64[np.ndarray, "2 rows cols"], Float32[np.ndarray, "2 some_draws rows cols"]]:
    """Return the slopes of a window without its bias, the bias that may be left, and some draws of the noise in that.

    The bias is ``whole_bias`` times the mean, over the pixels about each, of what the window differs by from the next smaller one
    (``before``), which counts by its ``trust``. What the smaller one does to draws is known, so that they lose the same. Left is
    what that mean itself smooths away. The smallest window is held against the measured normals: then the difference is all of
    its bias, and no law is needed.

    Within a window's reach of the rim the bias changes from pixel to pixel, so that those as deep (``depth_px``) tell each other.
    Where whole windows are so, they are not all as far from it in a straight line (``straight_px``): what that adds is taken off
    too, and left as well, since it is told by rings a pixel apart.
    The law holds for whole windows only. A cut one is held against the smaller one where that is whole and clear of its own bias.
    Where that is cut, too, the law's bias is as large, but may have the other sign: all of it is left.
    Pixels that are not ``within`` the tile hardly tell: the tile cuts their windows.
    """
    # A window with hardly more places than terms says next to nothing, and would spoil those about it.
    weight = trust / (now.variance + before.fitted.variance)
    factor = whole_bias(half_width, smaller)
    change = factor * (now.slope - before.fitted.slope)
    weight = np.where(within, weight, CUT_WEIGHT * weight)
    ring = {"half_width": half_width, "smaller": smaller}
    law = _by_depth(change, weight, depth_px, half_width=half_width)
    law_drawn = np.float32(factor) * (now.drawn - before.fitted.drawn)
    law_drawn = _by_depth(law_drawn, weight, depth_px, half_width=half_width)
    law = _within_rings(law, weight, depth_px, straight_px, half_width=half_width)
    bias = _bias(law, now.slope - before.clear.slope, weight, depth_px, **ring)
    drawn = _bias(law_drawn, now.drawn - before.clear.drawn, weight, depth_px, **ring)
    some = np.s_[:, :LEFT_DRAWS]
    left = _left(law, bias, weight, depth_px, **ring)
    left_drawn = _left(law_drawn[some], drawn[some], weight, depth_px, **ring)
    return Slopes(now.slope - bias, now.drawn - drawn, now.variance), left, left_drawn


def bias_left(
    square: ScalarMap,
    noise_square: ScalarMap,
    before: ClearSlopes,
    told: Mask,
    depth_px: ScalarMap,
    *,
    half_width: int,
    smaller: int,
) -> ScalarMap:
    """Return the mean square of the tilts by the bias that is left, from that of each pixel and that of the noise in it.

    A pixel's own square is mostly noise, and windows would be chosen where it happens to be small. So it is that of the pixels
    about it that are as deep and are ``told`` of, less the noise. A cut window that was held against a smaller one has the bias
    that is left in that one, too.
    """
    own = square - noise_square
    # Where no neighbour tells, nothing is known of the noise.
    result, alone = square.copy(), told.astype(np.float64)
    for first, last in pairwise(LEFT_DEPTHS_PX):
        there = (depth_px >= first) & (depth_px < last)
        alike = np.where(there, alone, 0.0)
        replace_by_means(own, alike, there & told, result, window_px=LEFT_WINDOW_PX)
    against = (depth_px > smaller) & (depth_px <= half_width) & (smaller > 0)
    return np.maximum(result, 0.0) + np.where(against, before.left_squared, 0.0)


def _bias(
    law: Float[np.ndarray, "2 *draws rows cols"],
    against: Float[np.ndarray, "2 *draws rows cols"],
    weight: ScalarMap,
    depth_px: ScalarMap,
    *,
    half_width: int,
    smaller: int,
) -> Float[np.ndarray, "2 *draws rows cols"]:
    """Return what is taken off: the law's bias of whole windows; of cut ones what they are off ``against`` whole smaller ones."""
    result = np.where(depth_px > half_width, law, law.dtype.type(0))
    _replace_by_those_alike(against, weight, depth_px, range(smaller + 1, half_width + 1), result)
    return result


def _left(
    law: Float[np.ndarray, "2 *draws rows cols"],
    bias: Float[np.ndarray, "2 *draws rows cols"],
    weight: ScalarMap,
    depth_px: ScalarMap,
    *,
    half_width: int,
    smaller: int,
) -> Float[np.ndarray, "2 *draws rows cols"]:
    """Return what the means smooth away of the bias, and all of the law's where nothing was taken off."""
    smooth = np.where(depth_px > half_width, _by_depth(law, weight, depth_px, half_width=half_width), law.dtype.type(0))
    _replace_by_those_alike(bias, weight, depth_px, range(smaller + 1, half_width + 1), smooth)
    return np.where(depth_px > smaller, bias, law) - smooth


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
    _replace_by_those_alike(slopes, weight, depth_px, range(first + 1, last + 1), result)
    return result


def _within_rings(
    law: Float64[np.ndarray, "2 rows cols"],
    weight: ScalarMap,
    depth_px: ScalarMap,
    straight_px: ScalarMap,
    *,
    half_width: int,
) -> Float64[np.ndarray, "2 rows cols"]:
    """Return the law's means over rings of whole windows as they are at each pixel's own distance from the rim.

    Pixels that are as deep are not as far from a rim that runs aslant: they are up to a pixel apart. How the bias changes with
    that distance follows from the rings about each.
    """
    first, last = half_width + 1, half_width + BIAS_WINDOW_PX // 2
    there = (depth_px >= first) & (depth_px <= last)
    if not there.any():
        return law
    mean = straight_px.copy()
    _replace_by_those_alike(straight_px[None], weight, depth_px, range(first, last + 1), mean[None])
    about = ((depth_px >= first) & (depth_px <= last + SLOPE_WINDOW_PX // 2)).astype(np.float64)
    fields = np.concatenate([mean[None], mean[None] ** 2, law, law * mean])
    far, far_squared, *told = weighted_means(fields, about, window_px=SLOPE_WINDOW_PX)
    spread, shared = far_squared - far**2, np.stack(told[2:]) - np.stack(told[:2]) * far
    slope = np.where(spread > LEAST_SPREAD_PX2, shared / np.maximum(spread, LEAST_SPREAD_PX2), 0.0)
    return np.where(there, law + slope * (straight_px - mean), law)


def _replace_by_those_alike(
    slopes: Float[np.ndarray, "*draws rows cols"],
    weight: ScalarMap,
    depth_px: ScalarMap,
    depths: range,
    result: Float[np.ndarray, "*draws rows cols"],
) -> None:
    """Write, at each of these depths, the weighted mean over the pixels along the rim that are as deep."""
    for depth in depths:
        there = depth_px == depth
        replace_by_means(slopes, np.where(there, weight, 0.0), there, result, window_px=RIM_WINDOW_PX)
