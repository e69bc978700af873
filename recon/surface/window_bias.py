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
# What is left of it is told as a mean square over so many pixels across, several of which are independent.
LEFT_WINDOW_PX = 33
# So many draws tell the noise in it over as many pixels.
LEFT_DRAWS = 4
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


@dataclass(frozen=True, slots=True, eq=False)
class ClearSlopes:
    """Slopes as they were ``fitted`` and ``clear`` of their bias, and the mean square of the tilt by what may be left of it."""

    fitted: Slopes
    clear: Slopes
    left_squared: ScalarMap


def own_slopes(normal: VectorMap, mask: Mask) -> ClearSlopes:
    """Return the slopes that the measured normals tell, which have no bias."""
    up = np.where(mask, normal[..., 2], 1.0)
    slope = np.stack([np.where(mask, -normal[..., axis] / up, 0.0) for axis in (0, 1)])
    own = Slopes(slope, np.empty((2, 0, *mask.shape), np.float32), np.zeros(mask.shape))
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
    within: Mask,
    *,
    half_width: int,
    smaller: int,
) -> tuple[Slopes, Float64[np.ndarray, "2 rows cols"], Float32[np.ndarray, "2 some_draws rows cols"]]:
    """Return the slopes of a window without its bias, the bias that may be left, and some draws of the noise in that.

    The bias is ``whole_bias`` times the mean, over the pixels about each, of what the window differs by from the next smaller one
    (``before``), which counts by its ``trust``. What the smaller one does to draws is known, so that they lose the same. From
    measured normals it is not: then nothing is taken off, and all of it is left. Otherwise, left is what that mean itself smooths
    away.

    Within a window's reach of the rim the bias changes from pixel to pixel, so that those as deep (``depth_px``) tell each other.
    The law holds for whole windows only. A cut one is held against the smaller one where that is whole and clear of its own bias.
    Where that is cut, too, the law's bias is as large, but may have the other sign: all of it is left.
    Pixels that are not ``within`` the tile hardly tell: the tile cuts their windows.
    """
    # A window with hardly more places than terms says next to nothing, and would spoil those about it.
    weight = trust / (now.variance + before.fitted.variance)
    factor = whole_bias(half_width, smaller)
    change = factor * (now.slope - before.fitted.slope)
    if before.fitted.drawn.shape[1] < now.drawn.shape[1]:
        return now, weighted_means(change, weight, window_px=OWN_WINDOW_PX), now.drawn[:, :0]
    weight = np.where(within, weight, CUT_WEIGHT * weight)
    ring = {"half_width": half_width, "smaller": smaller}
    law = _by_depth(change, weight, depth_px, half_width=half_width)
    law_drawn = np.float32(factor) * (now.drawn - before.fitted.drawn)
    law_drawn = _by_depth(law_drawn, weight, depth_px, half_width=half_width)
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
    deepest = half_width + BIAS_WINDOW_PX // 2 + 1
    for depth in range(1, deepest + 1):
        there = (depth_px == depth) if depth < deepest else (depth_px >= depth)
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


def _replace_by_those_alike(
    slopes: Float[np.ndarray, "2 *draws rows cols"],
    weight: ScalarMap,
    depth_px: ScalarMap,
    depths: range,
    result: Float[np.ndarray, "2 *draws rows cols"],
) -> None:
    """Write, at each of these depths, the weighted mean over the pixels along the rim that are as deep."""
    for depth in depths:
        there = depth_px == depth
        replace_by_means(slopes, np.where(there, weight, 0.0), there, result, window_px=RIM_WINDOW_PX)
