"""What all windows about a pixel say of it, and what of that can be believed: one surface, or the side of a crease."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Bool, Float64, Int64

from recon.maps import Maps
from recon.surface.crease import crease_between
from recon.surface.local_surfaces import Guess, guess_from

NARROW_PX, WIDE_PX = (2, 4), (2, 4, 8)
# Windows as wide stand about the pixel, and beside it so that it is just outside: at a crease these know one side each.
BESIDE = tuple(product((0, 1, -1), repeat=2))
# What several windows say must differ by no more than so many sd, or they know different surfaces.
ALIKE_SD = 4.0
# A point less sure than this many neighbours are apart, or a normal than this angle, is not worth having.
LARGEST_SHARE = 1.0
LARGEST_NORMAL_SD_RAD = np.radians(10.0)
# All windows about so many pixels are small beside the maps of an object.
PIXELS_AT_ONCE = 1024

Mask = Bool[np.ndarray, "rows cols"]
Whole = Int64[np.ndarray, " pixels"]
Some = Bool[np.ndarray, " pixels"]
PerPixel = Float64[np.ndarray, " pixels"]


def in_parts(pixels: Int64[np.ndarray, " all"]) -> list[Whole]:
    """Return the pixels in parts that are guessed at a time."""
    return [pixels[low : low + PIXELS_AT_ONCE] for low in range(0, len(pixels), PIXELS_AT_ONCE)]


def guessed(maps: Maps, known: Mask, row: Whole, col: Whole, *, half_widths: tuple[int, ...]) -> tuple[Guess, Some]:
    """Return what the ``known`` pixels about each say of it, and whether that can be believed."""
    return best_guess(*windows_about(maps, known, row, col, half_widths=half_widths))


def windows_about(
    maps: Maps, known: Mask, row: Whole, col: Whole, *, half_widths: tuple[int, ...]
) -> tuple["Guesses", PerPixel]:
    """Return what all windows of ``known`` pixels about each pixel say, and how far neighbours' points are apart there, in mm."""
    spacing_mm = _spacing(maps, known, row, col)
    return _guesses(maps, known, row, col, spacing_mm, half_widths), spacing_mm


@dataclass(frozen=True, slots=True, eq=False)
class Guesses:
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
) -> Guesses:
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
    return Guesses(every, np.stack(counted))


def best_guess(guesses: Guesses, spacing_mm: PerPixel) -> tuple[Guess, Some]:
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
