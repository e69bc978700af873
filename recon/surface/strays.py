"""Points beside left-out pixels that the surface within contradicts: what spoiled those may have spoiled them unseen.

An error along the plane of both light paths leaves no gap. Where a pixel at the rim takes a wrong period of a code, or a bubble
bends its path there, only the points farther from the rim show it.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import minimum_filter

from recon.maps import Maps, Support
from recon.status import PixelStatus
from recon.surface.local_surfaces import Guess
from recon.surface.window_guesses import (
    NARROW_PX,
    WIDE_PX,
    Guesses,
    Some,
    Whole,
    best_guess,
    in_parts,
    windows_about,
)

# By so many sd of both a point or a normal must be off the surface through the others.
STRAY_SD = 5.0


def without_strays(maps: Maps, *, threads: int = 1) -> Maps:
    """Return the maps without such points; their status is ``STANDS_ALONE``. So many ``threads`` share the pixels."""
    known = maps.valid() & np.isfinite(maps.normal).all(axis=2)
    trusted = minimum_filter(known, size=3, mode="nearest")
    row, col = (each.astype(np.int64) for each in np.nonzero(known & ~trusted))
    stray, left = np.zeros(len(row), dtype=bool), np.ones(len(row), dtype=bool)

    def ask(some: Whole, half_widths: tuple[int, ...]) -> None:
        here, there = row[some], col[some]
        windows, spacing_mm = windows_about(maps, trusted, here, there, half_widths=half_widths)
        told, believed = best_guess(windows, spacing_mm)
        left[some] = ~believed
        stray[some] = np.where(believed, _off(maps, here, there, told), _off_all(maps, here, there, windows))

    with ThreadPoolExecutor(threads) as pool:
        for half_widths in (NARROW_PX, WIDE_PX):
            list(pool.map(partial(ask, half_widths=half_widths), in_parts(np.flatnonzero(left))))
    lost = np.zeros(known.shape, dtype=bool)
    lost[row[stray], col[stray]] = True
    return replace(
        maps,
        point_mm=np.where(lost[..., None], np.nan, maps.point_mm),
        normal=np.where(lost[..., None], np.nan, maps.normal),
        sd_mm=np.where(lost, np.float32(np.nan), maps.sd_mm),
        status=np.where(lost, np.uint8(PixelStatus.STANDS_ALONE), maps.status),
        **{
            name: np.where(lost, blank, values)
            for name, blank in (
                ("normal_sd_rad", np.float32(np.nan)),
                ("across_sd_mm", np.float32(np.nan)),
                ("support", np.uint8(Support.NONE)),
            )
            if (values := getattr(maps, name)) is not None
        },
    )


def _off(maps: Maps, row: Whole, col: Whole, told: Guess) -> Some:
    """Tell which points or normals are far off what they should be, by the sds of both."""
    at = (row, col)
    own_mm2 = maps.sd_mm[at].astype(np.float64) ** 2
    with np.errstate(invalid="ignore"):
        off = ((maps.point_mm[at] - told.point_mm) ** 2).sum(axis=1) > STRAY_SD**2 * (told.variance_mm2 + own_mm2)
        if maps.normal_sd_rad is None:
            return off
        own_rad2 = maps.normal_sd_rad[at].astype(np.float64) ** 2
        turned = ((maps.normal[at] - told.normal) ** 2).sum(axis=1)
        return off | (turned > STRAY_SD**2 * (told.variance_rad2 + own_rad2))


def _off_all(maps: Maps, row: Whole, col: Whole, windows: Guesses) -> Some:
    """Tell which points are far off the surface that all windows know, and nearer to no neighbour than half as far.

    A surface that is not known well enough to cover a pixel still contradicts a point that is far enough from it: what the surest
    window says, and no window that knows the surface as well as that asks for says otherwise. Beyond a jump of depth the
    windows know the surface on this side alone; a point of the other has neighbours there.
    """
    point_mm = maps.point_mm[row, col]
    variance_mm2 = windows.stacked("variance_mm2")
    off_mm2 = ((windows.stacked("point_mm") - point_mm) ** 2).sum(axis=2)
    contradicts = off_mm2 > STRAY_SD**2 * (variance_mm2 + maps.sd_mm[row, col].astype(np.float64) ** 2)
    surest = (variance_mm2.argmin(axis=0), np.arange(len(row)))
    can_tell = STRAY_SD**2 * variance_mm2 < off_mm2[surest]
    alone = _nearest_squared(maps, row, col) > off_mm2[surest] / 4
    # Where some windows are sure enough, others that are not may know the side of a crease that the pixel looks at.
    unsure = ~windows.counted.any(axis=0)
    return unsure & alone & contradicts[surest] & (contradicts | ~can_tell).all(axis=0)


def _nearest_squared(maps: Maps, row: Whole, col: Whole) -> Float64[np.ndarray, " pixels"]:
    """Return the squared distance from each point to the nearest of its eight neighbours' points; infinite where it has none."""
    nearest_mm2 = np.full(len(row), np.inf)
    for down, along in product((-1, 0, 1), repeat=2):
        # Beyond the photo's edge lies the pixel itself, or a neighbour once more.
        beside = np.clip(row + down, 0, maps.status.shape[0] - 1), np.clip(col + along, 0, maps.status.shape[1] - 1)
        away_mm2 = ((maps.point_mm[beside] - maps.point_mm[row, col]) ** 2).sum(axis=1)
        itself = (beside[0] == row) & (beside[1] == col)
        nearest_mm2 = np.fmin(nearest_mm2, np.where(itself, np.inf, away_mm2))
    return nearest_mm2
