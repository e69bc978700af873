"""How far a part of the picture has moved between two photos of the same frame, to a small part of a pixel.

Least squares on the brightness itself (Lucas and Kanade 1981), block by block: where a picture moves by d, its brightness
changes by −d·∇I; where its light changes by the share g, by g·I. The gradient is taken half-way between the two photos, so that
the error of the straight line is of third order in d; a larger motion is first undone by whole pixels. Derivative and
prefilter are a matched pair (Farid and Simoncelli 2004, table I, five taps): a plain difference underestimates the slope of
fine texture, and the shift would come out too long.
"""

import itertools
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from recon.sweeps.noise import CHI_SQUARE_MEDIAN, ROUNDING_VARIANCE

Photo = Float32[np.ndarray, "rows columns"]
Mask = Bool[np.ndarray, "rows columns"]

PREFILTER = np.array([0.037659, 0.249153, 0.426375, 0.249153, 0.037659], np.float32)
DERIVATIVE = np.array([0.109604, 0.276691, 0.0, -0.276691, -0.109604], np.float32)
# What the filters reach beyond a pixel: a part is measured only that far inside its edge.
REACH_PX = 2
# About this many blocks across the photo: enough of them to see whether a part moves as one.
BLOCKS_ACROSS = 20
SMALLEST_BLOCK_PX = 8
# A block counts when this share of it belongs to the part: small marks do not lie on the blocks' grid.
SMALLEST_SHARE = 0.125
COARSE = 4
# Beyond this a shift is first undone by whole pixels.
LARGEST_STRAIGHT_PX = 0.6
ROUNDS = 4
# Medians of chi-square with one and with two degrees of freedom.
CHI_SQUARE_MEDIAN_2 = 1.3863
LEVEL_BINS = 10
FEWEST_IN_BIN = 50
# The median of n chi-squares with two degrees of freedom is good to 1 / (ln 2 · √n), its root to half of that; twice it.
CAUTION = 1.5
SMALLEST_INFLATION = 0.5
# What one count of noise in a hundred blocks can pretend: below it a pair of photos is the same file twice.
SMALLEST_SD_PX = 1e-4


@dataclass(frozen=True, slots=True)
class PhotoNoise:
    """Variance of one photo's counts, ``floor + slope · level``, and what the blocks really scatter over what it predicts.

    ``inflation`` is 1 for white noise; a camera that smooths or compresses its photos makes it larger.
    """

    floor: float
    slope: float
    inflation: float = 1.0

    def variance(self, level: Photo) -> Photo:
        """Return the variance of the difference of two photos at each place."""
        one = np.float32(self.floor) + np.float32(self.slope) * np.maximum(level, 0)
        return 2 * np.maximum(one, np.float32(ROUNDING_VARIANCE))


@dataclass(frozen=True, slots=True, eq=False)
class BlockShifts:
    """What each block of a part says on its own: shift (x, y) in px, the inverse of its covariance, and its light's change."""

    shift_px: Float64[np.ndarray, "blocks 2"]
    information: Float64[np.ndarray, "blocks 2 2"]
    light: Float64[np.ndarray, " blocks"]
    light_information: Float64[np.ndarray, " blocks"]


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
    """Return the photos' noise from two of them between which nothing changed.

    Raises ``ValueError`` when the mask holds too little to measure it from.
    """
    level, half_square = 0.5 * (first + second)[mask], 0.5 * ((second - first)[mask].astype(np.float64)) ** 2
    edges = np.quantile(level, np.linspace(0, 1, LEVEL_BINS + 1)) if level.size else np.zeros(2)
    places, variances = [], []
    for low, high in itertools.pairwise(edges):
        inside = (level >= low) & (level <= high)
        if np.count_nonzero(inside) >= FEWEST_IN_BIN:
            places.append(float(level[inside].mean()))
            # Counts are whole numbers, whose median jumps; the mean of what lies within three times it does not.
            square = half_square[inside]
            limit = 9 * max(float(np.median(square)) / CHI_SQUARE_MEDIAN, ROUNDING_VARIANCE)
            variances.append(float(square[square <= limit].mean()))
    if not places:
        raise ValueError("too few pixels to measure the photos' noise")
    slope, floor = np.polyfit(places, variances, 1) if len(places) > 2 else (0.0, float(np.mean(variances)))
    if slope < 0:
        slope, floor = 0.0, float(np.mean(variances))
    elif floor < 0:
        slope, floor = float(np.dot(places, variances) / np.dot(places, places)), 0.0
    white = PhotoNoise(float(floor), float(slope))
    blocks = block_shifts(first, second, mask, white)
    scatter = np.einsum("bi,bij,bj->b", blocks.shift_px, blocks.information, blocks.shift_px)
    inflation = float(np.sqrt(np.median(scatter) / CHI_SQUARE_MEDIAN_2)) if len(scatter) else 1.0
    # Few blocks measure it poorly; then rather too much than too little.
    inflation *= 1 + CAUTION / np.sqrt(max(len(scatter), 1))
    return PhotoNoise(white.floor, white.slope, max(SMALLEST_INFLATION, inflation))


def block_side_px(columns: int) -> int:
    """Return the side of a block in a photo of this width."""
    return max(SMALLEST_BLOCK_PX, columns // BLOCKS_ACROSS)


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


def block_shifts(first: Photo, second: Photo, mask: Mask, noise: PhotoNoise) -> BlockShifts:
    """Solve every block for its shift and its change of light.

    Per pixel: second − first = −d·∇I + g·I, weighted by the noise; prefilter and derivative run over the mean of both.
    """
    inside = cv2.erode(mask.astype(np.uint8), np.ones((2 * REACH_PX + 1,) * 2, np.uint8), borderValue=0)
    mean, change = np.float32(0.5) * (first + second), second - first
    level = cv2.sepFilter2D(mean, cv2.CV_32F, PREFILTER, PREFILTER)
    # sepFilter2D correlates: the derivative's kernel is turned round.
    along = cv2.sepFilter2D(mean, cv2.CV_32F, -DERIVATIVE, PREFILTER)
    down = cv2.sepFilter2D(mean, cv2.CV_32F, PREFILTER, -DERIVATIVE)
    change = cv2.sepFilter2D(change, cv2.CV_32F, PREFILTER, PREFILTER)
    weight = np.where(inside > 0, 1 / noise.variance(level), np.float32(0))
    side = block_side_px(first.shape[1])
    terms = (-along, -down, level)
    weighted = [term * weight for term in terms]
    normal = np.empty((*_block_shape(first, side), 3, 3))
    right = np.empty((*_block_shape(first, side), 3))
    for i in range(3):
        right[..., i] = _block_sums(weighted[i] * change, side)
        for j in range(i, 3):
            normal[..., i, j] = normal[..., j, i] = _block_sums(weighted[i] * terms[j], side)
    full = _block_sums((inside > 0).astype(np.float32), side) >= SMALLEST_SHARE * side * side
    return _solved(normal[full], right[full])


def _block_shape(photo: Photo, side: int) -> tuple[int, int]:
    return -(-photo.shape[0] // side), -(-photo.shape[1] // side)


def _block_sums(values: Photo, side: int) -> Float64[np.ndarray, "down across"]:
    rows, columns = _block_shape(values, side)
    padded = np.zeros((rows * side, columns * side), np.float32)
    padded[: values.shape[0], : values.shape[1]] = values
    return padded.reshape(rows, side, columns, side).sum(axis=(1, 3), dtype=np.float64)


def _solved(normal: Float64[np.ndarray, "blocks 3 3"], right: Float64[np.ndarray, "blocks 3"]) -> BlockShifts:
    """Solve three equations a block; blocks without enough texture for all three unknowns are left out."""
    diagonal = np.einsum("bii->bi", normal)
    usable = (diagonal > 0).all(axis=1)
    normal, right, diagonal = normal[usable], right[usable], diagonal[usable]
    scale = 1 / np.sqrt(diagonal)
    # With ones on the diagonal, a small smallest eigenvalue says that texture cannot tell the unknowns apart.
    usable = np.linalg.eigvalsh(normal * scale[:, :, None] * scale[:, None, :])[:, 0] > 1e-3
    normal, right = normal[usable], right[usable]
    if not len(normal):
        return BlockShifts(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0))
    solution = np.linalg.solve(normal, right[..., None])[..., 0]
    with_light = normal[:, :2, 2]
    information = normal[:, :2, :2] - with_light[:, :, None] * with_light[:, None, :] / normal[:, 2, 2][:, None, None]
    from_shift = np.linalg.solve(normal[:, :2, :2], with_light[..., None])[..., 0]
    light_information = normal[:, 2, 2] - (with_light * from_shift).sum(axis=1)
    return BlockShifts(solution[:, :2], information, solution[:, 2], light_information)


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
