"""Polynomial surfaces through places of windows of the map, one for each block of pixels.

A block's surface goes through it and its eight neighbours, by least squares.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import maximum_filter

# Places known worse than this (device pixels) may owe it to a flat likelihood, with errors alike all along a device pixel:
# those in a line of the window count as one.
FLAT_SD_PX = 0.05
# The surest places must not decide alone: the noise of compressed photos is not independent from one to the next.
SUREST_PX = 0.01
# Where the places of a window scatter more about its surface (chi-square over degrees of freedom) the map is not smooth.
LARGEST_ROUGHNESS = 4.0
# Of every term of a surface.
FEWEST_PIXELS = 2.5
# (power of the row, power of the column) of a surface's terms; both run from −1 to 1 over the window. What no quadratic surface
# tells, for the map's bend changes, a cubic one may.
TERMS = {degree: tuple((total - j, j) for total in range(degree + 1) for j in range(total + 1)) for degree in (2, 3)}
RIDGE = 1e-9
# Beyond its own window a block asks whether those of its neighbours are smooth.
MARGIN_BLOCKS = 2

Grid = Float[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]
Tile = tuple[slice, slice]


@dataclass(frozen=True, slots=True, eq=False)
class BlockSurfaces:
    """The surfaces of a grid of blocks, of one degree, by least squares through all places of each block's window.

    ``coefficients`` [terms, block rows, block columns]; their covariance is Aᵀ D⁻¹ A with the rows ``root`` = D^-½ A [terms,
    terms, …], ``misfit`` is chi-square and ``roughness`` that over degrees of freedom; blocks are ``rough`` where it is large
    there or beside. ``share_px`` is the sd of each place if what all know were dealt out evenly.
    """

    coefficients: np.ndarray
    root: np.ndarray
    misfit: np.ndarray
    roughness: np.ndarray
    rough: np.ndarray
    share_px: np.ndarray
    block_px: int
    degree: int

    def in_pixels(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return place, sd, share and whether the window is rough for every pixel of a tile of that size."""
        place = self.places(size)
        variance = np.zeros(size)
        for k, row in enumerate(self.root):
            variance += self._values(row[: k + 1], size) ** 2
        sd = np.sqrt(variance, out=variance) * self._spread(np.sqrt(np.maximum(self.roughness, 1.0)), size)
        return place, sd, self._spread(self.share_px, size), self._spread(self.rough, size)

    def places(self, size: tuple[int, int]) -> np.ndarray:
        """Return the surfaces' places for every pixel of a tile of that size."""
        return self._values(self.coefficients, size)

    def misfit_where_rough(self, size: tuple[int, int]) -> np.ndarray:
        """Return chi-square for every pixel of a tile of that size, infinite where its window is not rough."""
        misfit = np.where(self.roughness >= LARGEST_ROUGHNESS, self.misfit, np.inf)
        return self._spread(misfit, size)

    def _values(self, coefficients: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Return for every pixel the polynomial of the first terms with these coefficients."""
        position = (np.arange(self.block_px) - (self.block_px - 1) / 2) * (2 / (3 * self.block_px))
        terms = np.array([np.outer(position**i, position**j) for i, j in TERMS[self.degree][: len(coefficients)]])
        blocks = np.einsum("kij,krc->ricj", terms, coefficients, optimize=True)
        return blocks.reshape([self.block_px * count for count in self.roughness.shape])[: size[0], : size[1]]

    def _spread(self, values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        return values.repeat(self.block_px, axis=0).repeat(self.block_px, axis=1)[: size[0], : size[1]]


def block_surfaces(
    place_px: Grid, sd_px: Grid, usable: Mask, tile: Tile, *, block_px: int, degree: int
) -> BlockSurfaces:
    """Lay the surfaces of a tile, whose rows and columns begin with a block; its windows see what lies about it."""
    terms = TERMS[degree]
    (rows, row_padding), (cols, col_padding) = (
        _about(side, size, block_px) for side, size in zip(tile, place_px.shape, strict=True)
    )
    weight, value = weight_of(sd_px[rows, cols], usable[rows, cols], block_px), place_px[rows, cols]
    value = np.pad(np.where(usable[rows, cols], value, 0.0), (row_padding, col_padding))
    weight = np.pad(weight, (row_padding, col_padding))
    pull = weight * value
    moment = {
        name: _moments(one, block_px, most_power=most)
        for name, one, most in (
            ("weight", weight, 2 * degree),
            ("pull", pull, degree),
            ("square", pull * value, 0),
            ("number", (weight > 0).astype(np.float64), 0),
        )
    }
    number = moment["number"][0, 0]
    few = number < FEWEST_PIXELS * len(terms)
    total = np.where(few, np.inf, moment["weight"][0, 0])
    normal = np.array([[moment["weight"][i + k, j + m] / total for k, m in terms] for i, j in terms])
    right = np.array([moment["pull"][power] / total for power in terms])
    square = moment["square"][0, 0] / total
    # About the mean place of each window, so that little is lost in the differences of large numbers.
    mean = right[0].copy()
    square -= mean**2
    right -= mean * normal[0]
    root = _root_of_inverse(normal)
    halfway = np.einsum("ik...,k...->i...", root, right)
    coefficients = np.einsum("ik...,i...->k...", root, halfway)
    coefficients[0] += mean
    known = np.where(few, 1.0, total)
    misfit = known * np.maximum(square - np.einsum("i...,i...->...", halfway, halfway), 0.0)
    roughness = misfit / np.maximum(number - len(terms), 1.0)
    inner = (..., slice(1, -1), slice(1, -1))
    return BlockSurfaces(
        coefficients=coefficients[inner],
        root=(root / np.sqrt(known))[inner],
        misfit=misfit[inner],
        roughness=roughness[inner],
        rough=maximum_filter(roughness >= LARGEST_ROUGHNESS, 3)[inner],
        share_px=np.where(few, np.inf, np.sqrt(number / known))[inner],
        block_px=block_px,
        degree=degree,
    )


def _about(side: slice, size: int, block_px: int) -> tuple[slice, tuple[int, int]]:
    """Return a side of a tile with its margins, and how many pixels are missing before and behind to make whole blocks of it."""
    margin, length = MARGIN_BLOCKS * block_px, side.stop - side.start
    low, high = max(side.start - margin, 0), min(side.stop + margin, size)
    before = low - side.start + margin
    return slice(low, high), (before, length + -length % block_px + 2 * margin - before - (high - low))


def weight_of(sd_px: Grid, usable: Mask, block_px: int) -> np.ndarray:
    """Return what places weigh in the windows of blocks of that size."""
    weight = np.zeros(sd_px.shape)
    np.divide(1.0, sd_px.astype(np.float64) ** 2 + SUREST_PX**2, out=weight, where=usable)
    weight[sd_px > FLAT_SD_PX] /= 3 * block_px
    return weight


def _moments(values: np.ndarray, block_px: int, *, most_power: int) -> dict[tuple[int, int], np.ndarray]:
    """Return the sums of ``values`` times row^i column^j over each block's window, for i + j up to ``most_power``."""
    side = 3 * block_px
    position = (np.arange(side) - (side - 1) / 2) * (2 / side)
    powers = position ** np.arange(most_power + 1)[:, None]
    along = sliding_window_view(values, side, axis=1)[:, ::block_px] @ powers.T
    windows = sliding_window_view(along, side, axis=0)[::block_px]
    return {(i, j): windows[:, :, j] @ powers[i] for j in range(most_power + 1) for i in range(most_power + 1 - j)}


def _root_of_inverse(matrix: Float64[np.ndarray, "size size *many"]) -> Float64[np.ndarray, "size size *many"]:
    """Return lower triangles R with RᵀR the inverse of positive definite matrices, by elimination without pivots."""
    size = len(matrix)
    left = matrix.copy()
    unit = np.eye(size).reshape(size, size, *(1,) * (matrix.ndim - 2))
    left += RIDGE * unit
    root = np.broadcast_to(unit, matrix.shape).copy()
    for k in range(size - 1):
        factor = left[k + 1 :, k] / left[k, k]
        left[k + 1 :, k + 1 :] -= factor[:, None] * left[k, k + 1 :]
        root[k + 1 :, : k + 1] -= factor[:, None] * root[k, : k + 1]
    for k in range(size):
        root[k, : k + 1] /= np.sqrt(np.maximum(left[k, k], RIDGE))
    return root
