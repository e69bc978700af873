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
        """Return place, sd, share and whether the window is rough for every pixel of a band of that size."""
        position = (np.arange(self.block_px) - (self.block_px - 1) / 2) * (2 / (3 * self.block_px))
        terms = np.array([np.outer(position**i, position**j) for i, j in TERMS[self.degree]])
        shape = tuple(self.block_px * count for count in self.roughness.shape)
        place = np.einsum("kij,krc->ricj", terms, self.coefficients, optimize=True).reshape(shape)
        variance = np.zeros(shape)
        for k, row in enumerate(self.root):
            part = np.einsum("kij,krc->ricj", terms[: k + 1], row[: k + 1], optimize=True).reshape(shape)
            variance += np.square(part, out=part)
        inner = np.s_[: size[0], : size[1]]
        widened = self._spread(np.sqrt(np.maximum(self.roughness, 1.0)))
        sd = np.sqrt(variance, out=variance) * widened
        return place[inner], sd[inner], self._spread(self.share_px)[inner], self._spread(self.rough)[inner]

    def misfit_where_rough(self, size: tuple[int, int]) -> np.ndarray:
        """Return chi-square for every pixel of a band of that size, infinite where its window is not rough."""
        misfit = np.where(self.roughness >= LARGEST_ROUGHNESS, self.misfit, np.inf)
        return self._spread(misfit)[: size[0], : size[1]]

    def _spread(self, values: np.ndarray) -> np.ndarray:
        return values.repeat(self.block_px, axis=0).repeat(self.block_px, axis=1)


def block_surfaces(
    place_px: Grid, sd_px: Grid, usable: Mask, rows: slice, *, block_px: int, degree: int
) -> BlockSurfaces:
    """Lay the surfaces of a band of rows."""
    terms = TERMS[degree]
    weight, value = _padded(place_px, sd_px, usable, rows, block_px)
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


def _padded(place_px: Grid, sd_px: Grid, usable: Mask, rows: slice, block_px: int) -> tuple[np.ndarray, np.ndarray]:
    """Return weights and places of a band of rows in whole blocks, with a margin on each side; zeros where unusable."""
    margin = MARGIN_BLOCKS * block_px
    above, below = max(rows.start - margin, 0), min(rows.stop + margin, len(place_px))
    part = slice(above, below)
    band_rows, cols = -(-(rows.stop - rows.start) // block_px) * block_px, place_px.shape[1]
    before = above - rows.start + margin
    padding = (
        (before, band_rows + 2 * margin - before - (below - above)),
        (margin, -cols % block_px + margin),
    )
    weight = weight_of(sd_px[part], usable[part], block_px)
    return np.pad(weight, padding), np.pad(np.where(usable[part], place_px[part], 0.0), padding)


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
