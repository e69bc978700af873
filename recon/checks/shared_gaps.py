"""Gaps that neighbours share: noise parts the light paths of each pixel by itself, a wrong assumption those of all about it.

Light that enters the object again, or passes a bubble, comes along another path in liquid than in air; so do all its neighbours.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import uniform_filter

from recon.reconstruct import Crossing
from recon.status import PixelStatus

WINDOW_PX = 5
# Most of a window must be known; at its edges a mean is that of the half inside.
LEAST_SHARE = 0.6
# A lone stray path must not make its whole window stand out.
LARGEST_SD = 5.0
# The mean of a window stands out where it is this many times its own sd from nought, and this many of its pixels' sds: noise that
# neighbours share (JPEG, display pixels larger than those of the photo) makes up to 7 of the former, and 1.4 of the latter.
SIGMA = 8.0
SHARED_SD = 1.7

GridMap = Float64[np.ndarray, "rows cols"]


def shared_gaps(crossing: Crossing, *, shape: tuple[int, int]) -> tuple[GridMap, Bool[np.ndarray, "rows cols"]]:
    """Return the mean normalised gap about each pixel of the object, NaN where too little is known, and where it stands out."""
    with np.errstate(divide="ignore", invalid="ignore"):
        normalised = crossing.points.gap_mm / crossing.points.gap_sd_mm
    used = np.isfinite(normalised) & np.isin(crossing.status, (PixelStatus.OK, PixelStatus.GAP_TOO_LARGE))
    gap, known = np.zeros(shape), np.zeros(shape)
    gap.ravel()[crossing.pixels[used]] = np.clip(normalised[used], -LARGEST_SD, LARGEST_SD)
    known.ravel()[crossing.pixels[used]] = 1.0
    area = WINDOW_PX**2
    count = uniform_filter(known, WINDOW_PX, mode="constant") * area
    enough = count > LEAST_SHARE * area
    mean = np.where(enough, uniform_filter(gap, WINDOW_PX, mode="constant") * area / np.maximum(count, 1.0), np.nan)
    with np.errstate(invalid="ignore"):
        stands_out = enough & (np.abs(mean) * np.sqrt(count) > SIGMA) & (np.abs(mean) > SHARED_SD)
    return mean, stands_out


def with_shared_gaps(crossing: Crossing, *, shape: tuple[int, int], n_liquid: float, n_air: float) -> Crossing:
    """Return the crossings with what neighbours' shared gaps say in the variances that neighbours cannot average out.

    A path that is off by so much across the plane of both paths may be off as much within it, which moves the crossing by the
    gap over the sine of the angle; and turned by the gap over the distance to the display, which turns the normal.
    """
    mean, stands_out = shared_gaps(crossing, shape=shape)
    off = stands_out.ravel()[crossing.pixels]
    points = crossing.points
    shared_mm = np.where(
        off, np.abs(np.nan_to_num(mean.ravel()[crossing.pixels])) * np.nan_to_num(points.gap_sd_mm), 0.0
    )
    u, v = crossing.liquid.direction, crossing.air.direction
    length = np.linalg.norm(n_liquid * u - n_air * v, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved_mm2 = np.where(off, (shared_mm / np.sin(points.angle_rad)) ** 2, 0.0)
        turned_rad2 = np.where(off, (n_liquid * shared_mm / (points.distance_liquid_mm * length)) ** 2, 0.0)
    return replace(
        crossing, carried_mm2=crossing.carried_mm2 + moved_mm2, carried_rad2=crossing.carried_rad2 + turned_rad2
    )
