"""Pixels of the object whose own measurement was left out, covered from the surface about them.

A bubble, a crease through a pixel, or a rim that leaves half of its light spoils a pixel's measurement and not the surface. Where
that is continuous around such a pixel, its neighbours tell where it looks. Nothing is covered across a jump, beyond the
outline, or where the pixel's own sound paths contradict it; such points have a status of their own.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from jaxtyping import Bool, Int64
from scipy.ndimage import maximum_filter

from recon.maps import Maps, Support
from recon.status import PixelStatus
from recon.surface.local_surfaces import Guess
from recon.surface.own_paths import OwnPaths
from recon.surface.window_guesses import NARROW_PX, WIDE_PX, guessed, in_parts

# Why a pixel has no point though it may look at the object.
COVERABLE = (
    PixelStatus.BAD_FIT,
    PixelStatus.GAP_TOO_LARGE,
    PixelStatus.BAD_CODE,
    PixelStatus.TWO_PATHS,
    PixelStatus.HALF_SEEN,
    PixelStatus.STANDS_ALONE,
    PixelStatus.WET_SPOT,
)
# Narrow windows are enough where a point is near; in the middle of a hole only wide ones see its other side.
NEAR_PX = 2
PATH_SD = 4.0

Mask = Bool[np.ndarray, "rows cols"]
Whole = Int64[np.ndarray, " pixels"]
Some = Bool[np.ndarray, " pixels"]


def with_covered(maps: Maps, own: OwnPaths, *, threads: int = 1) -> Maps:
    """Return the maps with points and normals at the pixels that the surface about them covers: status ``COVERED``.

    So many ``threads`` share the pixels.
    """
    point_mm, normal, status = maps.point_mm.copy(), maps.normal.copy(), maps.status.copy()
    sd_mm = maps.sd_mm.copy()
    normal_sd, across_sd, support = (
        None if each is None else each.copy() for each in (maps.normal_sd_rad, maps.across_sd_mm, maps.support)
    )
    for row, col, told in _covered(maps, own, threads=threads):
        at = (row, col)
        point_mm[at], normal[at], sd_mm[at] = told.point_mm, told.normal, np.sqrt(told.variance_mm2)
        status[at] = PixelStatus.COVERED
        if normal_sd is not None:
            normal_sd[at] = np.sqrt(told.variance_rad2)
        if across_sd is not None:
            across_sd[at] = np.sqrt(told.across_mm2)
        if support is not None:
            support[at] = Support.COVERED
    return replace(
        maps,
        point_mm=point_mm,
        normal=normal,
        sd_mm=sd_mm,
        status=status,
        normal_sd_rad=normal_sd,
        across_sd_mm=across_sd,
        support=support,
    )


def _covered(maps: Maps, own: OwnPaths, *, threads: int) -> Iterator[tuple[Whole, Whole, Guess]]:
    """Yield rows and columns of pixels that are covered, with what covers them."""
    known = maps.valid() & np.isfinite(maps.normal).all(axis=2)
    missing = np.isin(maps.status, COVERABLE)
    row, col = (each.astype(np.int64) for each in np.nonzero(missing & _near(known, 2 * max(WIDE_PX))))
    within = enclosed(known, missing)[row, col]
    beside = within | _near(known, 1)[row, col]
    row, col, within = row[beside], col[beside], within[beside]
    left = np.ones(len(row), dtype=bool)

    def ask(some: Whole, half_widths: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, Guess]:
        here, there = row[some], col[some]
        told, believed = guessed(maps, known, here, there, half_widths=half_widths)
        left[some] = ~believed
        use = believed & _possible(own, here * known.shape[1] + there, told, within[some])
        return here[use], there[use], told.some(use)

    with ThreadPoolExecutor(threads) as pool:
        for half_widths, asked in ((NARROW_PX, _near(known, NEAR_PX)[row, col]), (WIDE_PX, np.ones_like(left))):
            yield from pool.map(partial(ask, half_widths=half_widths), in_parts(np.flatnonzero(left & asked)))


def _possible(own: OwnPaths, pixel: Whole, told: Guess, within: Some) -> Some:
    """Tell which points the pixels' own paths allow.

    Within the outline one sound path is enough, and none where both are disturbed. Beyond the last point, and by one pixel at
    most, only the path in liquid can say that the surface goes on.
    """
    liquid, air = (
        own.passes(medium, pixel, told.point_mm, told.variance_mm2, sigma=PATH_SD) for medium in ("liquid", "air")
    )
    return np.where(within, (liquid != -1) | (air != -1), liquid == 1)


def _near(known: Mask, reach_px: int) -> Mask:
    """Return the pixels with a known one in the square about them."""
    return maximum_filter(known, size=2 * reach_px + 1, mode="constant", cval=False)


def enclosed(known: Mask, missing: Mask) -> Mask:
    """Tell which missing pixels have a known one on all four sides, with nothing but missing pixels in between.

    Examples
    --------
    >>> known = np.ones((3, 4), dtype=bool)
    >>> known[1, 1:3] = False
    >>> enclosed(known, ~known)[1].tolist()
    [False, True, True, False]
    """
    result = missing.copy()
    for axis, flip in product((0, 1), (False, True)):
        seen, other = (np.flip(each, axis) if flip else each for each in (known, ~known & ~missing))
        number = np.arange(known.shape[axis], dtype=np.int32).reshape((-1, 1) if axis == 0 else (1, -1))
        last_seen = np.maximum.accumulate(np.where(seen, number, -1), axis=axis)
        last_other = np.maximum.accumulate(np.where(other, number, -1), axis=axis)
        met = last_seen > last_other
        result &= np.flip(met, axis) if flip else met
    return result
