"""Gaps that neighbours share: noise parts the light paths of each pixel by itself, a wrong assumption those of all about it.

Light that enters the object again, or passes a bubble, comes along another path in liquid than in air; so do all its neighbours.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, UInt8
from scipy.ndimage import binary_closing, binary_dilation, distance_transform_edt, uniform_filter

from recon.geometry.crossing_tests import outside_depth
from recon.reconstruct import Crossing
from recon.sessions.manifest import Manifest
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

# Gaps that are alike over more of the object than this are no spot but an area, which is wrong where its gaps are small as well:
# between parts that stand out, and so far beyond.
AREA_SHARE = 0.02
AREA_CLOSED_PX, AREA_GROWN_PX = 9, 3

GridMap = Float64[np.ndarray, "rows cols"]


@dataclass(frozen=True, slots=True, eq=False)
class SharedGaps:
    """The mean normalised gap about each pixel of the object, NaN where too little is known, and where it stands out.

    ``crossed`` is how many pixels have paths that were crossed on the object.
    """

    mean: GridMap
    stands_out: Bool[np.ndarray, "rows cols"]
    crossed: int

    @property
    def share(self) -> float:
        """The share of the object where it stands out."""
        return np.count_nonzero(self.stands_out) / max(self.crossed, 1)

    def area(self) -> Bool[np.ndarray, "rows cols"]:
        """Return the area whose gaps neighbours share, whole and with its edge; nothing where only spots stand out."""
        if self.share <= AREA_SHARE:
            return np.zeros(self.mean.shape, dtype=bool)
        closed = binary_closing(self.stands_out, np.ones((AREA_CLOSED_PX,) * 2, dtype=bool))
        return binary_dilation(closed | self.stands_out, np.ones((3, 3), dtype=bool), iterations=AREA_GROWN_PX)


def shared_gaps(crossing: Crossing, *, shape: tuple[int, int]) -> SharedGaps:
    """Average the gaps about each pixel of the object."""
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
    crossed = int(np.count_nonzero(np.isin(crossing.status, (PixelStatus.OK, PixelStatus.GAP_TOO_LARGE))))
    return SharedGaps(mean, stands_out, crossed)


def with_gaps_of_area(
    status: UInt8[np.ndarray, " pixels"],
    crossing: Crossing,
    shared: SharedGaps,
    manifest: Manifest,
    *,
    sigma: float,
    spots: Bool[np.ndarray, "rows cols"] | None = None,
) -> tuple[UInt8[np.ndarray, " pixels"], Crossing]:
    """Give points to pixels of an area whose gap is too large for noise, and that of those about them all the same.

    Such a gap is the area's, of which the standard deviations will tell, and those about it with a slightly smaller one have
    points: odd is only what differs from its neighbours' mean by so many ``sigma``. Those of bubbles' ``spots`` stay without.
    """
    mean = np.where(shared.area(), shared.mean, np.nan).ravel()[crossing.pixels]
    with np.errstate(divide="ignore", invalid="ignore"):
        alike = np.abs(crossing.points.gap_mm / crossing.points.gap_sd_mm - mean) < sigma
    found = alike & (crossing.status == PixelStatus.GAP_TOO_LARGE) & ~outside_depth(crossing.points, manifest)
    if spots is not None:
        found &= ~spots.ravel()[crossing.pixels]
    if not found.any():
        return status, crossing
    ours = np.where(found, np.uint8(PixelStatus.OK), crossing.status)
    everywhere = status.copy()
    everywhere[crossing.pixels] = ours
    return everywhere, replace(crossing, status=ours)


def with_shared_gaps(crossing: Crossing, shared: SharedGaps, *, n_liquid: float, n_air: float) -> Crossing:
    """Return the crossings with what neighbours' shared gaps say in the variances that neighbours cannot average out.

    A path that is off by so much across the plane of both paths may be off as much within it, which moves the crossing by the
    gap over the sine of the angle; and turned by the gap over the distance to the display, which turns the normal.
    """
    stands_out = shared.stands_out
    if not stands_out.any():
        return crossing
    # What an area's edge and its inner parts hide is as large as what the nearest part that stands out shows.
    nearest = distance_transform_edt(~stands_out, return_distances=False, return_indices=True)
    off = (stands_out | shared.area()).ravel()[crossing.pixels]
    points = crossing.points
    shown = np.abs(np.nan_to_num(shared.mean))[tuple(nearest)].ravel()[crossing.pixels]
    # That is a mean of gaps cut short: a pixel's own that is larger counts by itself.
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.abs(points.gap_mm / points.gap_sd_mm)
    shown = np.where((own > LARGEST_SD) & np.isfinite(own), np.fmax(shown, own), shown)
    shared_mm = np.where(off, shown * np.nan_to_num(points.gap_sd_mm), 0.0)
    u, v = crossing.liquid.direction, crossing.air.direction
    length = np.linalg.norm(n_liquid * u - n_air * v, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved_mm2 = np.where(off, (shared_mm / np.sin(points.angle_rad)) ** 2, 0.0)
        turned_rad2 = np.where(off, (n_liquid * shared_mm / (points.distance_liquid_mm * length)) ** 2, 0.0)
    return replace(
        crossing, carried_mm2=crossing.carried_mm2 + moved_mm2, carried_rad2=crossing.carried_rad2 + turned_rad2
    )
