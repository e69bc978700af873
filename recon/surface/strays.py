"""Points beside left-out pixels that the surface within contradicts: what spoiled those may have spoiled them unseen.

An error along the plane of both light paths leaves no gap. Where a pixel at the rim takes a wrong period of a code, or a bubble
bends its path there, only the points farther from the rim show it.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.ndimage import minimum_filter

from recon.maps import Maps, Support
from recon.status import PixelStatus
from recon.surface.local_surfaces import Guess
from recon.surface.window_guesses import NARROW_PX, WIDE_PX, Some, Whole, guessed, in_parts

# By so many sd of both a point or a normal must be off the surface through the others.
STRAY_SD = 5.0


def without_strays(maps: Maps, *, threads: int = 1) -> Maps:
    """Return the maps without such points; their status is ``STANDS_ALONE``. So many ``threads`` share the pixels."""
    known = maps.valid() & np.isfinite(maps.normal).all(axis=2)
    trusted = minimum_filter(known, size=3, mode="nearest")
    row, col = (each.astype(np.int64) for each in np.nonzero(known & ~trusted))
    stray, left = np.zeros(len(row), dtype=bool), np.ones(len(row), dtype=bool)

    def ask(some: Whole, half_widths: tuple[int, ...]) -> None:
        told, believed = guessed(maps, trusted, row[some], col[some], half_widths=half_widths)
        left[some] = ~believed
        stray[some] = believed & _off(maps, row[some], col[some], told)

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
