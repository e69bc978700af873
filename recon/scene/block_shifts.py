"""What each block of a part of the picture says by itself of its motion and its light, from one photo to another.

Least squares on the brightness itself (Lucas and Kanade 1981), block by block: where a picture moves by d, its brightness
changes by −d·∇I; where its light changes by the share g, by g·I. The gradient is taken half-way between the two photos, so that
the error of the straight line is of third order in d. Derivative and prefilter are a matched pair (Farid and Simoncelli 2004,
table I, five taps): a plain difference underestimates the slope of fine texture, and the shift would come out too long.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from recon.scene.photo_noise import Mask, Photo, PhotoNoise

PREFILTER = np.array([0.037659, 0.249153, 0.426375, 0.249153, 0.037659], np.float32)
DERIVATIVE = np.array([0.109604, 0.276691, 0.0, -0.276691, -0.109604], np.float32)
# What the filters reach beyond a pixel: a part is measured only that far inside its edge.
REACH_PX = 2
# About this many blocks across the photo: enough of them to see whether a part moves as one.
BLOCKS_ACROSS = 20
SMALLEST_BLOCK_PX = 8
# A block counts when this share of it belongs to the part: small marks do not lie on the blocks' grid.
SMALLEST_SHARE = 0.125


@dataclass(frozen=True, slots=True, eq=False)
class BlockShifts:
    """What each block of a part says on its own: shift (x, y) in px, the inverse of its covariance, and its light's change."""

    shift_px: Float64[np.ndarray, "blocks 2"]
    information: Float64[np.ndarray, "blocks 2 2"]
    light: Float64[np.ndarray, " blocks"]
    light_information: Float64[np.ndarray, " blocks"]


def block_side_px(columns: int) -> int:
    """Return the side of a block in a photo of this width."""
    return max(SMALLEST_BLOCK_PX, columns // BLOCKS_ACROSS)


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
