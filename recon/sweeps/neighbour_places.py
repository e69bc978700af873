"""Where within a display pixel a camera pixel looks, told by its neighbours.

A display shows a stripe in steps, one level a device pixel. A camera pixel whose footprint lies within one device pixel sees
the same curve wherever in it that is: its likelihood is flat over an interval, its place the interval's middle, and the error
a sawtooth of the true place, alike in all neighbours that look at the same device pixels. Averages do not take it away, and
what hangs on small differences (the liquid's index, registration) takes it for truth.

But the footprints of some neighbours straddle two device pixels, and their curves tell to a hundredth of a pixel where. The map
from camera to display is smooth, so a quadratic surface through a window, each place weighted by what its curve tells, says where
in their intervals the others look. Nothing that a pixel's own curve told is given up: no place leaves its interval, none moves
where the neighbourhood is not smooth, and places known as well as their neighbours' stay as they are. Beside an edge, where
photos are compressed with errors that a smooth surface would follow, nothing is told.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import maximum_filter

# A block's surface goes through it and its eight neighbours. Such a window must see some four device pixels, or hardly any
# footprint in it straddles two; where it knows too little a larger one is asked.
BLOCKS_PX = (3, 5, 8)
WINDOW_REACH_PX = 4.0
# A place is told where its window knows places so many times better, each of them on average and the one by all together.
FAR_BETTER = 2.0
# Places known worse than this (device pixels) may owe it to a flat likelihood, with errors alike all along a device pixel:
# those in a line of the window count as one.
FLAT_SD_PX = 0.05
# The surest places must not decide alone: the noise of compressed photos is not independent from one to the next.
SUREST_PX = 0.01
# Where the places of a window scatter more about its surface (chi-square over degrees of freedom) the map is not smooth.
LARGEST_ROUGHNESS = 4.0
FEWEST_PIXELS = 16
# The end of an interval, in standard deviations of a place that lies anywhere in it.
INTERVAL_END_SD = np.sqrt(3.0)
BEYOND_END_SIGMA = 3.0
# (power of the row, power of the column) of a surface's terms; both run from −1 to 1 over the window.
TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
MOST_POWER = 2
RIDGE = 1e-9
BAND_BLOCKS = 16
# Beyond its own window a block asks whether those of its neighbours are smooth.
MARGIN_BLOCKS = 2

Grid = Float[np.ndarray, "rows cols"]


def told_by_neighbours(
    place_px: Grid, sd_px: Grid, *, trusted: Bool[np.ndarray, "rows cols"], reach_px: Grid
) -> tuple[Grid, Grid]:
    """Return places and sds in device pixels, those of flat likelihoods settled within their intervals where neighbours can.

    Parameters
    ----------
    place_px, sd_px
        Maps in device pixels, NaN where there is no place.
    trusted
        Pixels that saw one stripe, by one path: they alone tell and are told.
    reach_px
        How far the footprint of a pixel reaches along the display's axis, NaN where its likelihood is not flat.

    Notes
    -----
    A new sd is the surface's, widened by its roughness, and in quadrature an even share of what the window knows: what is
    told adds nothing to what neighbours know, and must not count many times where places are averaged as independent.
    """
    usable = trusted & np.isfinite(place_px) & (sd_px > 0)
    waiting = usable & (reach_px >= 0)
    if not waiting.any():
        return place_px, sd_px
    place, sd = place_px.copy(), sd_px.copy()
    for block_px in BLOCKS_PX:
        # The largest window is tried whatever the reach.
        smallest_px = WINDOW_REACH_PX / (3 * block_px) if block_px < BLOCKS_PX[-1] else 0.0
        for top in range(0, len(place), BAND_BLOCKS * block_px):
            rows = slice(top, min(top + BAND_BLOCKS * block_px, len(place)))
            asking = waiting[rows] & (reach_px[rows] >= smallest_px)
            if not asking.any():
                continue
            surfaces = _surfaces(place_px, sd_px, usable, rows, block_px=block_px)
            own, own_sd = place_px[rows], sd_px[rows].astype(np.float64)
            told, told_sd, share, rough = (one[: len(own), : own.shape[1]] for one in surfaces.in_blocks())
            with np.errstate(invalid="ignore"):
                end = INTERVAL_END_SD * own_sd
                agreed = asking & ~rough & (FAR_BETTER * np.maximum(told_sd, share) < own_sd)
                agreed &= np.abs(told - own) < end + BEYOND_END_SIGMA * told_sd
            np.copyto(place[rows], np.clip(told, own - end, own + end), where=agreed)
            np.copyto(sd[rows], np.hypot(told_sd, share), where=agreed, casting="same_kind")
            waiting[rows] &= ~agreed
    return place, sd


@dataclass(frozen=True, slots=True, eq=False)
class _Surfaces:
    """The quadratic surfaces of a grid of blocks, by least squares through all places of each block's window.

    ``coefficients`` [6, block rows, block columns]; their covariance is Aᵀ D⁻¹ A with the rows ``root`` = D^-½ A [6, 6, …], and
    ``roughness`` chi-square over degrees of freedom; blocks are ``rough`` where that is large there or beside. ``share_px`` is
    the sd of each place if what all know were dealt out evenly.
    """

    coefficients: np.ndarray
    root: np.ndarray
    roughness: np.ndarray
    rough: np.ndarray
    share_px: np.ndarray
    block_px: int

    def in_blocks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return place, sd, share and whether the window is rough for every pixel of the blocks, on the pixels' grid."""
        position = (np.arange(self.block_px) - (self.block_px - 1) / 2) * (2 / (3 * self.block_px))
        terms = np.array([np.outer(position**i, position**j) for i, j in TERMS])
        shape = tuple(self.block_px * size for size in self.roughness.shape)
        place = np.einsum("kij,krc->ricj", terms, self.coefficients, optimize=True).reshape(shape)
        variance = np.zeros(shape)
        for k, row in enumerate(self.root):
            part = np.einsum("kij,krc->ricj", terms[: k + 1], row[: k + 1], optimize=True).reshape(shape)
            variance += np.square(part, out=part)
        widened = np.sqrt(np.maximum(self.roughness, 1.0))
        sd = np.sqrt(variance, out=variance) * self._spread(widened)
        return place, sd, self._spread(self.share_px), self._spread(self.rough)

    def _spread(self, values: np.ndarray) -> np.ndarray:
        return values.repeat(self.block_px, axis=0).repeat(self.block_px, axis=1)


def _surfaces(
    place_px: Grid, sd_px: Grid, usable: Bool[np.ndarray, "rows cols"], rows: slice, *, block_px: int
) -> _Surfaces:
    """Lay the surfaces of a band of rows."""
    weight, value = _padded(place_px, sd_px, usable, rows, block_px)
    pull = weight * value
    moment = {
        name: _moments(one, block_px, most_power=most)
        for name, one, most in (
            ("weight", weight, 2 * MOST_POWER),
            ("pull", pull, MOST_POWER),
            ("square", pull * value, 0),
            ("number", (weight > 0).astype(np.float64), 0),
        )
    }
    number = moment["number"][0, 0]
    few = number < FEWEST_PIXELS
    total = np.where(few, np.inf, moment["weight"][0, 0])
    normal = np.array([[moment["weight"][i + k, j + m] / total for k, m in TERMS] for i, j in TERMS])
    right = np.array([moment["pull"][power] / total for power in TERMS])
    square = moment["square"][0, 0] / total
    # About the mean place of each window, so that little is lost in the differences of large numbers.
    mean = right[0].copy()
    square -= mean**2
    right -= mean * normal[0]
    root = _root_of_inverse(normal)
    halfway = np.einsum("ik...,k...->i...", root, right)
    coefficients = np.einsum("ik...,i...->k...", root, halfway)
    coefficients[0] += mean
    left = np.maximum(square - np.einsum("i...,i...->...", halfway, halfway), 0.0)
    known = np.where(few, 1.0, total)
    roughness = left * known / np.maximum(number - len(TERMS), 1.0)
    inner = (..., slice(1, -1), slice(1, -1))
    return _Surfaces(
        coefficients=coefficients[inner],
        root=(root / np.sqrt(known))[inner],
        roughness=roughness[inner],
        rough=maximum_filter(roughness >= LARGEST_ROUGHNESS, 3)[inner],
        share_px=np.where(few, np.inf, np.sqrt(number / known))[inner],
        block_px=block_px,
    )


def _padded(
    place_px: np.ndarray, sd_px: np.ndarray, usable: np.ndarray, rows: slice, block_px: int
) -> tuple[np.ndarray, np.ndarray]:
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
    weight = np.zeros((below - above, cols))
    np.divide(1.0, sd_px[part].astype(np.float64) ** 2 + SUREST_PX**2, out=weight, where=usable[part])
    weight[sd_px[part] > FLAT_SD_PX] /= 3 * block_px
    return np.pad(weight, padding), np.pad(np.where(usable[part], place_px[part], 0.0), padding)


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
