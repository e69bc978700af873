"""The pixels of a mask as unknowns, and the pairs of neighbours that tie them together."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32
from scipy.ndimage import label
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from recon.compiled import compiled


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


def parts_of(mask: Bool[np.ndarray, "rows cols"]) -> Int32[np.ndarray, " pixels"]:
    """Label the connected parts of a mask, from 0: those of all its pairs."""
    return np.asarray(label(mask)[0][mask], np.int32) - np.int32(1)


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
    count = neighbours.pixels
    starts = np.zeros(count + 1, np.int32)
    _count_entries(neighbours.first, neighbours.second, starts)
    columns, values = np.empty(starts[-1], np.int32), np.empty(starts[-1])
    _write_equations(neighbours.first, neighbours.second, at_first, at_second, weight, own, starts, columns, values)
    return csr_array((values, columns, starts), shape=(count, count))


@compiled
def _count_entries(first: np.ndarray, second: np.ndarray, starts: np.ndarray) -> None:
    """Write where each row of the matrix starts: it has an entry of its own, and one for each neighbour."""
    for pixel in range(1, len(starts)):
        starts[pixel] = 1
    for pair in range(len(first)):
        starts[first[pair] + 1] += 1
        starts[second[pair] + 1] += 1
    for pixel in range(1, len(starts)):
        starts[pixel] += starts[pixel - 1]


@compiled
def _write_equations(
    first: np.ndarray,
    second: np.ndarray,
    at_first: np.ndarray,
    at_second: np.ndarray,
    weight: np.ndarray,
    own: np.ndarray,
    starts: np.ndarray,
    columns: np.ndarray,
    values: np.ndarray,
) -> None:
    """Write the rows of the matrix, each with its columns ascending."""
    end = starts[:-1].copy()
    for pixel in range(len(end)):
        columns[end[pixel]], values[end[pixel]] = pixel, own[pixel]
        end[pixel] += 1
    for pair in range(len(first)):
        one, other = first[pair], second[pair]
        values[starts[one]] += weight[pair] * at_first[pair] ** 2
        values[starts[other]] += weight[pair] * at_second[pair] ** 2
        coupling = weight[pair] * at_first[pair] * at_second[pair]
        columns[end[one]], values[end[one]] = other, coupling
        columns[end[other]], values[end[other]] = one, coupling
        end[one] += 1
        end[other] += 1
    for pixel in range(len(end)):
        for place in range(starts[pixel] + 1, end[pixel]):
            column, value = columns[place], values[place]
            while place > starts[pixel] and columns[place - 1] > column:
                columns[place], values[place] = columns[place - 1], values[place - 1]
                place -= 1
            columns[place], values[place] = column, value
