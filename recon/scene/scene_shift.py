"""How far a part of the picture has moved between two photos of the same frame, to a small part of a pixel.

Its blocks (:mod:`recon.scene.block_shifts`) are weighed together, and asked whether they agree. A motion too large for a straight
line is first undone by whole pixels.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from recon.scene.block_shifts import SMALLEST_BLOCK_PX, BlockShifts, block_shifts
from recon.scene.photo_noise import Mask, Photo, PhotoNoise, white_noise

COARSE = 4
# Beyond this a shift is first undone by whole pixels.
LARGEST_STRAIGHT_PX = 0.6
ROUNDS = 4
# Median of chi-square with two degrees of freedom.
CHI_SQUARE_MEDIAN_2 = 1.3863
# The median of n chi-squares with two degrees of freedom is good to 1 / (ln 2 · √n), its root to half of that; twice it.
CAUTION = 1.5
SMALLEST_INFLATION = 0.5
# What one count of noise in a hundred blocks can pretend: below it a pair of photos is the same file twice.
SMALLEST_SD_PX = 1e-4


@dataclass(frozen=True, slots=True)
class PartShift:
    """How a part of the picture changed from the first photo to the second.

    ``shift_px`` (x, y) with its standard deviations ``sd_px``, and ``sigma``, its length in standard deviations; ``spread_px`` is
    how differently its blocks moved, rms beyond noise, and ``spread_sigma`` how sure that is; ``light`` is the relative
    change of brightness, with ``light_sd``.
    """

    shift_px: tuple[float, float]
    sd_px: tuple[float, float]
    sigma: float
    spread_px: float
    spread_sigma: float
    light: float
    light_sd: float
    blocks: int

    def enlarged(self, factor: int) -> "PartShift":
        """Return the same change in the pixels of a photo that was measured ``factor`` times smaller."""
        (x, y), (sd_x, sd_y) = self.shift_px, self.sd_px
        return replace(
            self,
            shift_px=(factor * x, factor * y),
            sd_px=(factor * sd_x, factor * sd_y),
            spread_px=factor * self.spread_px,
        )

    @property
    def length_px(self) -> float:
        """Length of the shift."""
        return float(np.hypot(*self.shift_px))


def noise_of_pair(first: Photo, second: Photo, mask: Mask) -> PhotoNoise:
    """Return the photos' noise from two of them between which nothing changed, by how their blocks scatter.

    Raises ``ValueError`` when the mask holds too little to measure it from.
    """
    white = white_noise(first, second, mask)
    blocks = block_shifts(first, second, mask, white)
    scatter = np.einsum("bi,bij,bj->b", blocks.shift_px, blocks.information, blocks.shift_px)
    inflation = float(np.sqrt(np.median(scatter) / CHI_SQUARE_MEDIAN_2)) if len(scatter) else 1.0
    # Few blocks measure it poorly; then rather too much than too little.
    inflation *= 1 + CAUTION / np.sqrt(max(len(scatter), 1))
    return PhotoNoise(white.floor, white.slope, max(SMALLEST_INFLATION, inflation))


def part_shift(first: Photo, second: Photo, mask: Mask, noise: PhotoNoise) -> PartShift | None:
    """Return how the part under ``mask`` changed, None where it has too little texture to tell.

    Photos are counts as float32; pixels that are clipped or that another part touches should be left out of the mask.
    """
    start = _coarse_start(first, second, mask, noise)
    for _ in range(ROUNDS):
        blocks = block_shifts(first, _rolled(second, start), mask & _kept(mask, start), noise)
        found = _combined(blocks, noise, start)
        if found is None:
            return None
        rest = np.array(found.shift_px) - start
        if np.abs(rest).max() <= LARGEST_STRAIGHT_PX:
            break
        start = start + np.rint(rest).astype(int)
    return found


def _combined(
    blocks: BlockShifts, noise: PhotoNoise, start: Float64[np.ndarray, " 2"] | np.ndarray
) -> PartShift | None:
    """Weigh the blocks together and ask whether they agree."""
    count = len(blocks.light)
    if count == 0:
        return None
    variance = noise.inflation**2
    total = blocks.information.sum(axis=0)
    mean = np.linalg.solve(total, np.einsum("bij,bj->i", blocks.information, blocks.shift_px))
    shift = mean + start
    sd = np.maximum(np.sqrt(variance * np.diag(np.linalg.inv(total))), SMALLEST_SD_PX)
    apart = blocks.shift_px - mean
    chi_square = float(np.einsum("bi,bij,bj->", apart, blocks.information, apart)) / variance
    freedom = 2 * count - 2
    spread_px, spread_sigma = 0.0, 0.0
    if freedom > 0:
        spread_sigma = (chi_square - freedom) / np.sqrt(2 * freedom)
        # Each block and axis weighs by its own variance, so that noise adds one a block to the sum.
        weight = 1 / np.einsum("bii->bi", np.linalg.inv(blocks.information))
        beyond_noise = ((weight * apart**2).sum(axis=0) - variance * count) / weight.sum(axis=0)
        spread_px = float(np.sqrt(np.maximum(beyond_noise, 0.0).sum()))
    light_total = float(blocks.light_information.sum())
    light = float((blocks.light_information * blocks.light).sum() / light_total)
    return PartShift(
        shift_px=(float(shift[0]), float(shift[1])),
        sd_px=(float(sd[0]), float(sd[1])),
        sigma=float(np.sqrt(shift @ total @ shift / variance)),
        spread_px=spread_px,
        spread_sigma=float(spread_sigma),
        light=light,
        light_sd=float(np.sqrt(variance / light_total)),
        blocks=count,
    )


def _rolled(photo: Photo, shift: np.ndarray) -> Photo:
    """Undo a shift of whole pixels; what comes in at the border means nothing (see :func:`_kept`)."""
    return photo if not shift.any() else np.roll(photo, (-int(shift[1]), -int(shift[0])), axis=(0, 1))


def _kept(mask: Mask, shift: np.ndarray) -> Mask:
    """Return which pixels of a rolled photo were in the photo before."""
    rows, columns = mask.shape
    row, column = np.arange(rows)[:, None] + int(shift[1]), np.arange(columns)[None, :] + int(shift[0])
    return (row >= 0) & (row < rows) & (column >= 0) & (column < columns)


def _coarse_start(first: Photo, second: Photo, mask: Mask, noise: PhotoNoise) -> np.ndarray:
    """Look for a motion of several pixels in photos four times smaller; zero unless it is clearly there."""
    nothing = np.zeros(2, int)
    size = (first.shape[1] // COARSE, first.shape[0] // COARSE)
    if min(size) < 3 * SMALLEST_BLOCK_PX:
        return nothing
    small_first, small_second = (cv2.resize(photo, size, interpolation=cv2.INTER_AREA) for photo in (first, second))
    small_mask = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
    found = _combined(block_shifts(small_first, small_second, small_mask, noise), noise, nothing)
    if found is None or found.length_px * COARSE < 1.5 or found.sigma < 10:
        return nothing
    return np.rint(np.array(found.shift_px) * COARSE).astype(int)
