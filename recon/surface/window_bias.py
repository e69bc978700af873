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
# Windows cut at a rim, or by the tile, tell of the bias only where no whole one is near.
CUT_WEIGHT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Slopes along both axes of a tile, of its heights and then of the draws of their errors.

    ``variance`` is that of a slope for heights of variance one; 0 for the measured normals, of which there are no draws.
    """

    slope: Float64[np.ndarray, "2 fields rows cols"]
    variance: ScalarMap


def own_slopes(normal: VectorMap, mask: Mask) -> Slopes:
    """Return the slopes that the measured normals tell."""
    up = np.where(mask, normal[..., 2], 1.0)
    slope = np.stack([np.where(mask, -normal[..., axis] / up, 0.0) for axis in (0, 1)])
    return Slopes(slope[:, None], np.zeros(mask.shape))


def whole_bias(half_width: int, smaller: int) -> float:
    """Return a window's bias over what it differs by from that of a smaller window (0: the pixel's own normal, without bias).

    A cubic term c p³ gives the slope of the best quadratic polynomial over −h … h the bias c Σp⁴/Σp² = c (3h² + 3h − 1)/5.
    """
    bias = (3 * half_width**2 + 3 * half_width - 1) / 5
    return bias / (bias - ((3 * smaller**2 + 3 * smaller - 1) / 5 if smaller else 0.0))


def without_bias(
    now: Slopes, before: Slopes, trust: ScalarMap, depth_px: ScalarMap, within: Mask, *, half_width: int, smaller: int
) -> tuple[Float64[np.ndarray, "2 fields rows cols"], Float64[np.ndarray, "2 rows cols"]]:
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
    known = before.slope.shape[1]
    change = whole_bias(half_width, smaller) * (now.slope[:, :known] - before.slope)
    if known < now.slope.shape[1]:
        return now.slope, _mean(change, weight, window_px=OWN_WINDOW_PX)[:, 0]
    weight = np.where(within, weight, CUT_WEIGHT * weight)
    bias = _by_depth(change, weight, depth_px, half_width=half_width)
    left = bias[:, 0] - _by_depth(bias[:, :1], weight, depth_px, half_width=half_width)[:, 0]
    whole = depth_px > half_width
    return np.where(whole, now.slope - bias, now.slope), np.where(whole, left, bias[:, 0])


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
