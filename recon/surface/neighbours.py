"""The pixels of a mask as unknowns, and the pairs of neighbours that tie them together."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """Pixels of ``mask`` numbered row by row, and each pair (first, second) that shares an edge of the grid."""

    mask: Bool[np.ndarray, "rows cols"]
    first: Int32[np.ndarray, " pairs"]
    second: Int32[np.ndarray, " pairs"]

    @property
    def pixels(self) -> int:
        """Number of unknowns."""
        return int(self.mask.sum())

    def on_grid(self, values: Float64[np.ndarray, " pixels"]) -> Float64[np.ndarray, "rows cols"]:
        """Put one value a pixel back on the camera grid, NaN outside the mask."""
        grid = np.full(self.mask.shape, np.nan)
        grid[self.mask] = values
        return grid


def neighbours_of(mask: Bool[np.ndarray, "rows cols"]) -> Neighbours:
    """Number the pixels of ``mask`` and list their pairs: right-hand neighbours first, then those below."""
    number = np.full(mask.shape, -1, np.int32)
    number[mask] = np.arange(mask.sum(), dtype=np.int32)
    along, down = mask[:, :-1] & mask[:, 1:], mask[:-1] & mask[1:]
    first = np.concatenate([number[:, :-1][along], number[:-1][down]])
    second = np.concatenate([number[:, 1:][along], number[1:][down]])
    return Neighbours(mask, first, second)


def pairs_beyond(neighbours: Neighbours) -> tuple[Int32[np.ndarray, " pairs"], Int32[np.ndarray, " pairs"]]:
    """Return the pair before each pair and the one after it on its line of the grid, −1 where there is none."""
    first, second = neighbours.first, neighbours.second
    column = np.nonzero(neighbours.mask)[1]
    along_row = column[first] != column[second]
    before, after = np.full(len(first), -1, np.int32), np.full(len(first), -1, np.int32)
    for line in (along_row, ~along_row):
        pairs = np.flatnonzero(line).astype(np.int32)
        starting, ending = (np.full(neighbours.pixels, -1, np.int32) for _ in range(2))
        starting[first[pairs]], ending[second[pairs]] = pairs, pairs
        before[pairs], after[pairs] = ending[first[pairs]], starting[second[pairs]]
    return before, after


def components(
    pixels: int, first: Int32[np.ndarray, " pairs"], second: Int32[np.ndarray, " pairs"]
) -> Int32[np.ndarray, " pixels"]:
    """Label the connected parts of a graph of pixels, from 0."""
    graph = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(pixels, pixels))
    return connected_components(graph, directed=False)[1].astype(np.int32)


def normal_equations(
    neighbours: Neighbours,
    at_first: Float64[np.ndarray, " pairs"],
    at_second: Float64[np.ndarray, " pairs"],
    weight: Float64[np.ndarray, " pairs"],
    own: Float64[np.ndarray, " pixels"],
) -> csr_array:
    """Return the symmetric matrix of Σ weight (at_first x_first + at_second x_second)² + Σ own x²."""
    first, second, count = neighbours.first, neighbours.second, neighbours.pixels
    diagonal = own + np.bincount(first, weight * at_first**2, minlength=count)
    diagonal += np.bincount(second, weight * at_second**2, minlength=count)
    coupling = weight * at_first * at_second
    index = np.arange(count, dtype=np.int32)
    rows = np.concatenate([index, first, second])
    columns = np.concatenate([index, second, first])
    values = np.concatenate([diagonal, coupling, coupling])
    return coo_array((values, (rows, columns)), shape=(count, count)).tocsr()
