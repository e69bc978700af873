"""Pixels of the object whose own measurement was left out, covered from the surface about them.

A bubble, a crease through a pixel, or a rim that leaves half of its light spoils a pixel's measurement and not the surface. Where
that is continuous around such a pixel, its neighbours tell where it looks. Nothing is covered across a jump, beyond the
outline, or where the pixel's own sound paths contradict it; such points have a status of their own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.ndimage import maximum_filter

from recon.maps import Maps, Support
from recon.status import PixelStatus
from recon.surface.crease import crease_between
from recon.surface.local_surfaces import Guess, guess_from
from recon.surface.own_paths import OwnPaths

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
NARROW_PX, WIDE_PX = (2, 4), (2, 4, 8)
# Narrow windows are enough where a point is near; in the middle of a hole only wide ones see its other side.
NEAR_PX = 2
# Windows as wide stand about the pixel, and beside it so that it is just outside: at a crease these know one side each.
BESIDE = tuple(product((0, 1, -1), repeat=2))
# What several windows say must differ by no more than so many sd, or they know different surfaces.
ALIKE_SD = 4.0
PATH_SD = 4.0
# A point less sure than this many neighbours are apart, or a normal than this angle, is not worth having.
LARGEST_SHARE = 1.0
LARGEST_NORMAL_SD_RAD = np.radians(10.0)
PIXELS_AT_ONCE = 1024

Mask = Bool[np.ndarray, "rows cols"]
Whole = Int64[np.ndarray, " pixels"]
Some = Bool[np.ndarray, " pixels"]
PerPixel = Float64[np.ndarray, " pixels"]


def with_covered(maps: Maps, own: OwnPaths) -> Maps:
    """Return the maps with points and normals at the pixels that the surface about them covers: status ``COVERED``."""
    point_mm, normal, status = maps.point_mm.copy(), maps.normal.copy(), maps.status.copy()
    sd_mm = maps.sd_mm.copy()
    normal_sd, across_sd, support = (
        None if each is None else each.copy() for each in (maps.normal_sd_rad, maps.across_sd_mm, maps.support)
    )
    for row, col, told in _covered(maps, own):
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


def _covered(maps: Maps, own: OwnPaths) -> Iterator[tuple[Whole, Whole, Guess]]:
    """Yield rows and columns of pixels that are covered, with what covers them."""
    known = maps.valid() & np.isfinite(maps.normal).all(axis=2)
    missing = np.isin(maps.status, COVERABLE)
    row, col = (each.astype(np.int64) for each in np.nonzero(missing & _near(known, 2 * max(WIDE_PX))))
    within = enclosed(known, missing)[row, col]
    beside = within | _near(known, 1)[row, col]
    row, col, within = row[beside], col[beside], within[beside]
    left = np.ones(len(row), dtype=bool)
    for half_widths, asked in ((NARROW_PX, _near(known, NEAR_PX)[row, col]), (WIDE_PX, np.ones_like(left))):
        pixels = np.flatnonzero(left & asked)
        for low in range(0, len(pixels), PIXELS_AT_ONCE):
            some = pixels[low : low + PIXELS_AT_ONCE]
            here, there = row[some], col[some]
            spacing_mm = _spacing(maps, known, here, there)
            told, believed = best_guess(_guesses(maps, known, here, there, spacing_mm, half_widths), spacing_mm)
            left[some] = ~believed
            use = believed & _possible(own, here * known.shape[1] + there, told, within[some])
            yield here[use], there[use], told.some(use)


def _possible(own: OwnPaths, pixel: Whole, told: Guess, within: Some) -> Some:
    """Tell which points the pixels' own paths allow.

    Within the outline one sound path is enough, and none where both are disturbed. Beyond the last point, and by one pixel at
    most, only the path in liquid can say that the surface goes on.
    """
    liquid, air = (
        own.passes(medium, pixel, told.point_mm, told.variance_mm2, sigma=PATH_SD) for medium in ("liquid", "air")
    )
    return np.where(within, (liquid != -1) | (air != -1), liquid == 1)


@dataclass(frozen=True, slots=True, eq=False)
class _Guesses:
    """What all windows say of some pixels, a row each; ``counted`` those sure enough to be heard."""

    every: tuple[Guess, ...]
    counted: Bool[np.ndarray, "windows pixels"]

    def stacked(self, name: str) -> Float64[np.ndarray, "windows pixels ..."]:
        """Return one field of all windows."""
        return np.stack([getattr(one, name) for one in self.every])

    def of(self, window: Whole) -> Guess:
        """Return for each pixel what one window says."""
        pixel = np.arange(len(window))
        return Guess(*(self.stacked(name)[window, pixel] for name in Guess.__slots__))

    def contradict(self, window: Whole) -> Bool[np.ndarray, "windows pixels"]:
        """Tell which windows that count contradict that one, in the point or in the normal."""
        one = self.of(window)
        with np.errstate(invalid="ignore"):
            point, normal = (
                ((self.stacked(name) - getattr(one, name)) ** 2).sum(axis=2)
                / (self.stacked(variance) + getattr(one, variance))
                for name, variance in (("point_mm", "variance_mm2"), ("normal", "variance_rad2"))
            )
        return self.counted & (np.maximum(point, normal) > ALIKE_SD**2)


def _guesses(
    maps: Maps, known: Mask, row: Whole, col: Whole, spacing_mm: PerPixel, half_widths: tuple[int, ...]
) -> _Guesses:
    """Ask all windows about each pixel."""
    every = tuple(
        guess_from(maps, known, row, col, row + (wide + 1) * down, col + (wide + 1) * along, half_width=wide)
        for wide in half_widths
        for down, along in BESIDE
    )
    counted = [
        (one.variance_mm2 < (LARGEST_SHARE * spacing_mm) ** 2) & (one.variance_rad2 < LARGEST_NORMAL_SD_RAD**2)
        for one in every
    ]
    return _Guesses(every, np.stack(counted))


def best_guess(guesses: _Guesses, spacing_mm: PerPixel) -> tuple[Guess, Some]:
    """Return what to believe of each pixel, and whether it can be believed.

    It is what the surest window says, where all others agree. Where some do not and two surfaces meet in a crease, it
    is the one on whose side of their meeting line the pixel looks.
    """
    # A normal's error counts by what it does to a neighbour's point.
    score = np.full(guesses.counted.shape, np.inf)
    together = guesses.stacked("variance_mm2") + spacing_mm**2 * np.minimum(guesses.stacked("variance_rad2"), 1.0)
    score[guesses.counted] = together[guesses.counted]
    first = score.argmin(axis=0)
    against = guesses.contradict(first)
    second = np.where(against, score, np.inf).argmin(axis=0)
    third = guesses.contradict(second) & against
    one, other = guesses.of(first), guesses.of(second)
    crease = crease_between(one, other, spacing_mm)
    alone = ~against.any(axis=0)
    believed = guesses.counted[first, np.arange(len(first))] & (alone | (crease.meets & ~third.any(axis=0)))
    chosen = guesses.of(np.where(alone | crease.on_first, first, second))
    doubt = np.where(alone, 0.0, crease.wrong_side)
    return (
        replace(
            chosen,
            variance_mm2=chosen.variance_mm2 + doubt * ((one.point_mm - other.point_mm) ** 2).sum(axis=1),
            variance_rad2=chosen.variance_rad2 + doubt * ((one.normal - other.normal) ** 2).sum(axis=1),
        ),
        believed,
    )


def _near(known: Mask, reach_px: int) -> Mask:
    """Return the pixels with a known one in the square about them."""
    return maximum_filter(known, size=2 * reach_px + 1, mode="constant", cval=False)


def _spacing(maps: Maps, known: Mask, row: Whole, col: Whole) -> PerPixel:
    """Return how far the points of neighbours are apart about each pixel, by the median of a window; 0 where none is known."""
    reach = max(WIDE_PX)
    side = np.arange(-reach, reach + 1)
    rows = np.clip(row[:, None, None] + side[:, None], 0, known.shape[0] - 1)
    cols = np.clip(col[:, None, None] + side, 1, known.shape[1] - 1)
    both = known[rows, cols] & known[rows, cols - 1]
    length_mm = np.linalg.norm(maps.point_mm[rows, cols] - maps.point_mm[rows, cols - 1], axis=3)
    step = np.where(both, length_mm, np.nan).reshape(len(row), -1)
    result = np.zeros(len(row))
    some = both.reshape(len(row), -1).any(axis=1)
    result[some] = np.nanmedian(step[some], axis=1)
    return result


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
        number = np.arange(known.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
        last_seen = np.maximum.accumulate(np.where(seen, number, -1), axis=axis)
        last_other = np.maximum.accumulate(np.where(other, number, -1), axis=axis)
        met = last_seen > last_other
        result &= np.flip(met, axis) if flip else met
    return result
