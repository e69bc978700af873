"""Weighted means over a square window about every pixel, of several fields with the same weights."""

import numpy as np
from jaxtyping import Bool, Float, Float64

from recon.compiled import compiled

# So many numbers a core takes at a time, or a whole part of it.
STEP = 16


def weighted_means(
    fields: Float[np.ndarray, "*fields rows cols"], weight: Float64[np.ndarray, "rows cols"], *, window_px: int
) -> Float[np.ndarray, "*fields rows cols"]:
    """Return the mean of the pixels with a weight within a window about each; 0 where it holds none.

    A value that is not a number counts as 0. The window is 5, 9 or 17 wide: a power of two and one.
    """
    means = np.empty_like(fields)
    replace_by_means(fields, weight, np.ones(weight.shape, dtype=bool), means, window_px=window_px)
    return means


def replace_by_means(
    fields: Float[np.ndarray, "*fields rows cols"],
    weight: Float64[np.ndarray, "rows cols"],
    there: Bool[np.ndarray, "rows cols"],
    result: Float[np.ndarray, "*fields rows cols"],
    *,
    window_px: int,
) -> None:
    """Write :func:`weighted_means` into the result, at some of the pixels alone."""
    if not there.any():
        return
    planes = np.ascontiguousarray(fields).reshape(-1, *weight.shape)
    write_means(planes, np.ascontiguousarray(weight), window_px // 2, there, result.reshape(planes.shape))


@compiled
def write_means(fields: np.ndarray, weight: np.ndarray, reach: int, there: np.ndarray, means: np.ndarray) -> None:
    """Write the means over as many pixels as ``reach`` on either side, where they are asked for.

    Lines have a margin, and a length that a core takes in whole steps. Loops are given a map and the number of a row: taking out
    the row by itself would cost as much as the loop.
    """
    rows, cols = weight.shape
    held = np.zeros((rows + 2 * reach, (cols + 2 * reach + STEP - 1) // STEP * STEP), fields.dtype)
    inner = held[reach:, reach:]
    first, second = np.zeros(held.shape[1] + reach, held.dtype), np.zeros(held.shape[1] + reach, held.dtype)
    sums, inverse = np.empty(cols, held.dtype), np.zeros((rows, cols), held.dtype)
    asked = np.zeros(rows, np.bool_)
    for row in range(rows):
        for col in range(cols):
            inner[row, col] = weight[row, col]
            asked[row] |= there[row, col]
    for row in range(rows):
        if asked[row]:
            sum_windows(held, row, reach, first, second, sums)
            for col in range(cols):
                inverse[row, col] = 1.0 / sums[col] if sums[col] > 0 else 0.0
    for number in range(len(fields)):
        for row in range(rows):
            weigh(fields, number, weight, row, inner)
        for row in range(rows):
            if asked[row]:
                sum_windows(held, row, reach, first, second, sums)
                for col in range(cols):
                    mean = sums[col] * inverse[row, col]
                    means[number, row, col] = mean if there[row, col] else means[number, row, col]


@compiled
def weigh(fields: np.ndarray, number: int, weight: np.ndarray, row: int, held: np.ndarray) -> None:
    """Write each value of a row times its weight; what is not a number counts as 0."""
    for col in range(weight.shape[1]):
        value = fields[number, row, col] * weight[row, col]
        held[row, col] = value if abs(value) < np.inf else 0.0


@compiled
def sum_windows(
    held: np.ndarray, row: int, reach: int, first: np.ndarray, second: np.ndarray, sums: np.ndarray
) -> None:
    """Write a row of the sums over windows, whose first rows and columns are those of the margin."""
    for place in range(held.shape[1]):
        first[place] = held[row, place]
    for other in range(row + 1, row + 2 * reach, 4):
        add_four(first, held, other)
    for col in range(len(sums)):
        sums[col] = first[2 * reach + col]
    # By twos along the row.
    step, line, twice = 1, first, second
    while step < 2 * reach:
        for place in range(held.shape[1]):
            twice[place] = line[place] + line[place + step]
        step, line, twice = 2 * step, twice, line
    for col in range(len(sums)):
        sums[col] += line[col]


@compiled
def add_four(total: np.ndarray, held: np.ndarray, row: int) -> None:
    """Add four rows to a line, in place."""
    for place in range(held.shape[1]):
        upper, lower = held[row, place] + held[row + 1, place], held[row + 2, place] + held[row + 3, place]
        total[place] += upper + lower
