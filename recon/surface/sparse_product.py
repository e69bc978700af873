"""Products of sparse matrices, whose rows threads share, and matrices as compiled loops read them."""

import numpy as np
from scipy.sparse import csr_array

from recon.bands import over_bands
from recon.compiled import compiled


def product(one: csr_array, other: csr_array, *, threads: int = 1) -> csr_array:
    """Return the product of two sparse matrices, row by row (Gustavson 1978), a row's last new column first.

    Examples
    --------
    >>> one = csr_array(np.array([[1.0, 2.0], [0.0, 3.0]]))
    >>> product(one, one).toarray().tolist()
    [[1.0, 8.0], [0.0, 9.0]]
    """
    rows, cols = one.shape[0], other.shape[1]
    entries = np.zeros(rows, np.int32)

    def count(band: slice) -> None:
        _count_entries(*rows_of(one)[:2], *rows_of(other)[:2], band.start, band.stop, cols, entries)

    over_bands(count, rows, threads=threads)
    starts = np.zeros(rows + 1, np.int32)
    np.cumsum(entries, out=starts[1:])
    columns, values = np.empty(starts[-1], np.int32), np.empty(starts[-1])

    def write(band: slice) -> None:
        _write_entries(
            *(*rows_of(one), *rows_of(other)),
            *(band.start, band.stop, cols, starts, columns, values),
        )

    over_bands(write, rows, threads=threads)
    return csr_array((values, columns, starts), shape=(rows, cols))


def rows_of(matrix: csr_array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where the rows start, their columns and values; compiled loops need not ask whether a column counts from the end."""
    return matrix.indptr, matrix.indices.astype(np.int32, copy=False).view(np.uint32), matrix.data


@compiled
def _count_entries(
    starts: np.ndarray,
    unknowns: np.ndarray,
    other_starts: np.ndarray,
    other_unknowns: np.ndarray,
    first: int,
    end: int,
    cols: int,
    entries: np.ndarray,
) -> None:
    """Write how many entries the rows of the product from ``first`` to before ``end`` have."""
    last_row = np.full(cols, -1, np.int32)
    for row in range(first, end):
        for place in range(starts[row], starts[row + 1]):
            through = unknowns[place]
            for to in range(other_starts[through], other_starts[through + 1]):
                col = other_unknowns[to]
                if last_row[col] != row:
                    last_row[col] = row
                    entries[row] += 1


@compiled
def _write_entries(
    starts: np.ndarray,
    unknowns: np.ndarray,
    values: np.ndarray,
    other_starts: np.ndarray,
    other_unknowns: np.ndarray,
    other_values: np.ndarray,
    first: int,
    end: int,
    cols: int,
    product_starts: np.ndarray,
    product_columns: np.ndarray,
    product_values: np.ndarray,
) -> None:
    """Write the columns and values of those rows."""
    place_of = np.full(cols, -1, np.int32)
    for row in range(first, end):
        begin, left = product_starts[row], product_starts[row + 1]
        for place in range(starts[row], starts[row + 1]):
            through, value = unknowns[place], values[place]
            for to in range(other_starts[through], other_starts[through + 1]):
                col = other_unknowns[to]
                # What an earlier row left lies before this one's first.
                if place_of[col] < begin:
                    left -= 1
                    place_of[col] = left
                    product_columns[left], product_values[left] = col, 0.0
                product_values[place_of[col]] += value * other_values[to]
