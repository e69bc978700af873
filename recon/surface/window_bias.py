"""The bias of a window's slopes, which a quadratic polynomial leaves where the surface bends more than that, taken off."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from recon.surface.ray_chords import Mask, ScalarMap, VectorMap

# The bias is taken from this many pixels across.
BIAS_WINDOW_PX = 9
# From the measured normals it is taken nearer by: beside a crease it is not that of pixels farther away.
OWN_WINDOW_PX = 5
# Along a rim it changes more slowly than across it.
RIM_WINDOW_PX = 17
# What is left of it is told as a mean square over so many pixels across, several of which are independent.
LEFT_WINDOW_PX = 25
# So many draws tell the noise in it over as many pixels.
LEFT_DRAWS = 4
# Windows cut at a rim, or by the tile, tell of the bias only where no whole one is near.
CUT_WEIGHT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Slopes along both axes of a tile, of its heights and then of the draws of their errors.

    ``variance`` is that of a slope for heights of variance one; 0 for the measured normals, of which there are no draws.
    """

    slope: Float64[np.ndarray, "2 fields rows cols"]
    variance: ScalarMap


@dataclass(frozen=True, slots=True, eq=False)
class ClearSlopes:
    """Slopes as they were ``fitted`` and without their bias (``slope``), and the squared tilt by what may be left of it."""

    fitted: Slopes
    slope: Float64[np.ndarray, "2 fields rows cols"]
    left_squared: ScalarMap


def own_slopes(normal: VectorMap, mask: Mask) -> ClearSlopes:
    """Return the slopes that the measured normals tell, which have no bias."""
    up = np.where(mask, normal[..., 2], 1.0)
    slope = np.stack([np.where(mask, -normal[..., axis] / up, 0.0) for axis in (0, 1)])[:, None]
    nothing = np.zeros(mask.shape)
    return ClearSlopes(Slopes(slope, nothing), slope, nothing)


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
) -> tuple[Float64[np.ndarray, "2 fields rows cols"], Float64[np.ndarray, "2 some_fields rows cols"]]:
    """Return the slopes of a window without its bias, and the bias that may be left, with some draws of the noise in it.

    The bias is ``whole_bias`` times the mean, over the pixels about each, of what the window differs by from the next smaller one
    (``before``), which counts by its ``trust``. What the smaller one does to draws is known, so that they lose the same. From
    measured normals it is not: then nothing is taken off, and all of it is left. Otherwise, left is what that mean itself smooths
    away.

    Within a window's reach of the rim the bias changes from pixel to pixel, so that those as deep (``depth_px``) tell each other.
    The law holds for whole windows only. A cut one is held against the smaller one where that is whole and rid of its own bias.
    Where that is cut, too, the law's bias is as large, but may have the other sign: all of it is left.
    Pixels that are not ``within`` the tile hardly tell: the tile cuts their windows.
    """
    # A window with hardly more places than terms says next to nothing, and would spoil those about it.
    weight = trust / (now.variance + before.fitted.variance)
    known = before.slope.shape[1]
    change = whole_bias(half_width, smaller) * (now.slope[:, :known] - before.fitted.slope)
    if known < now.slope.shape[1]:
        return now.slope, _mean(change, weight, window_px=OWN_WINDOW_PX)
    weight = np.where(within, weight, CUT_WEIGHT * weight)
    some = slice(1 + LEFT_DRAWS)
    bias = _by_depth(change, weight, depth_px, half_width=half_width)
    left = bias[:, some] - _by_depth(bias[:, some], weight, depth_px, half_width=half_width)
    cut = depth_px <= half_width
    left = np.where(cut, bias[:, some], left)
    bias[..., cut] = 0.0
    for depth in range(smaller + 1, half_width + 1):
        there = depth_px == depth
        if there.any():
            alike = np.where(there, weight, 0.0)
            against = _mean(now.slope - before.slope, alike, window_px=RIM_WINDOW_PX)
            bias[..., there] = against[..., there]
            again = _mean(against[:, some], alike, window_px=RIM_WINDOW_PX)
            left[..., there] = (against[:, some] - again)[..., there]
    return now.slope - bias, left


def bias_left(
    squares: Float64[np.ndarray, "some_fields rows cols"],
    before: ClearSlopes,
    told: Mask,
    depth_px: ScalarMap,
    *,
    half_width: int,
    smaller: int,
) -> ScalarMap:
    """Return the mean square of the tilts by the bias that is left, from that of each pixel and of the noise in it.

    A pixel's own square is mostly noise, and windows would be chosen where it happens to be small. So it is that of the pixels
    about it that are as deep and are ``told`` of, less the noise, which the draws show. A cut window that was held against a
    smaller one has the bias that is left in that one, too.
    """
    own = squares[0] - (squares[1:].mean(axis=0) if len(squares) > 1 else 0.0)
    # Where no neighbour tells, nothing is known of the noise.
    result = squares[0].copy()
    deepest = half_width + BIAS_WINDOW_PX // 2 + 1
    for depth in range(1, deepest + 1):
        there = depth_px == depth if depth < deepest else depth_px >= depth
        alike = (told & there).astype(np.float64)
        if alike.any():
            count = _box(alike, LEFT_WINDOW_PX)
            mean = _box(np.where(alike > 0, own, 0.0), LEFT_WINDOW_PX) / np.maximum(count, 1.0)
            some = there & (count > 0.5)
            result[some] = np.maximum(mean, 0.0)[some]
    against = (depth_px > smaller) & (depth_px <= half_width) & (smaller > 0)
    return np.where(against, result + np.nan_to_num(before.left_squared), result)


def _by_depth(
    slopes: Float64[np.ndarray, "2 fields rows cols"], weight: ScalarMap, depth_px: ScalarMap, *, half_width: int
) -> Float64[np.ndarray, "2 fields rows cols"]:
    """Return the weighted mean over whole windows about each pixel, and near the rim over those alone that are as deep.

    A cut window has that of the outermost whole ones.
    """
    first, last = half_width + 1, half_width + BIAS_WINDOW_PX // 2
    outermost = np.where(depth_px == first, weight, CUT_WEIGHT * weight)
    result = _mean(slopes, np.where(depth_px > half_width, weight, 0.0), window_px=BIAS_WINDOW_PX)
    for depth, there in [(first, depth_px <= first), *((k, depth_px == k) for k in range(first + 1, last + 1))]:
        if there.any():
            alike = outermost if depth == first else np.where(there, weight, 0.0)
            result[..., there] = _mean(slopes, alike, window_px=RIM_WINDOW_PX)[..., there]
    return result


def _mean(
    slopes: Float64[np.ndarray, "2 fields rows cols"], weight: ScalarMap, *, window_px: int
) -> Float64[np.ndarray, "2 fields rows cols"]:
    """Return the weighted mean over the window about each pixel."""
    total = _box(weight, window_px)
    total = np.where(total > 0, total, 1.0)
    held = np.where(weight > 0, np.nan_to_num(slopes) * weight, 0.0)
    return np.stack([np.stack([_box(field, window_px) / total for field in axis]) for axis in held])


def _box(values: ScalarMap, window_px: int) -> ScalarMap:
    window = (window_px, window_px)
    return np.asarray(
        cv2.boxFilter(values, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT), np.float64
    )
