"""Weighted means over a square window about every pixel, of several fields with the same weights."""

import numpy as np
from jaxtyping import Bool, Float, Float64

from recon.compiled import compiled

WIDTHS_PX = (5, 9, 17, 33)
# As far as they reach.
MARGIN_PX = 16
# No map is as wide; that it is known lets a core take several pixels at a time.
LONGEST = 1 << 20


def weighted_means(
    fields: Float[np.ndarray, "*fields rows cols"], weight: Float64[np.ndarray, "rows cols"], *, window_px: int
) -> Float[np.ndarray, "*fields rows cols"]:
    """Return the mean of the pixels with a weight within a window about each; 0 where it holds none.

    A value that is not a number counts as 0. The window is 5, 9, 17 or 33 wide.
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
    """Write :func:`weighted_means` into the result, at some of the pixels alone.

    Raises
    ------
    ValueError
        For a window of another width, and for a result whose fields do not lie one after the other.
    """
    if window_px not in WIDTHS_PX:
        raise ValueError(f"windows may be {WIDTHS_PX} pixels wide, not {window_px}")
    if not there.any():
        return
    planes = np.ascontiguousarray(fields).reshape(-1, *weight.shape)
    # What is written into a copy would be lost.
    into = result.reshape(planes.shape, copy=False)
    write_means(planes, np.ascontiguousarray(weight), window_px // 2, there, into)


@compiled
def write_means(fields: np.ndarray, weight: np.ndarray, reach: int, there: np.ndarray, means: np.ndarray) -> None:
    """Write the means over as many pixels as ``reach`` on either side, where they are asked for.

    Loops are given whole maps and the number of a row: taking out the row by itself would cost as much as the loop.
    """
    rows, cols = weight.shape
    top, bottom = bounds(there)
    first, last = max(top - reach, 0), min(bottom + reach, rows)
    held = np.zeros((rows + 2 * MARGIN_PX, cols + 2 * MARGIN_PX), fields.dtype)
    line, sums = np.zeros(cols + 2 * MARGIN_PX, fields.dtype), np.zeros(cols, fields.dtype)
    inverse = np.zeros((rows, cols), fields.dtype)
    for row in range(first, last):
        for col in range(cols):
            held[MARGIN_PX + row, MARGIN_PX + col] = weight[row, col]
    for row in range(top, bottom):
        sum_rows(held, row, reach, line)
        sum_columns(line, reach, sums)
        for col in range(cols):
            inverse[row, col] = 1.0 / sums[col] if sums[col] > 0 else 0.0
    for number in range(len(fields)):
        for row in range(first, last):
            weigh(fields, number, weight, row, held)
        for row in range(top, bottom):
            sum_rows(held, row, reach, line)
            sum_columns(line, reach, sums)
            for col in range(cols):
                mean = sums[col] * inverse[row, col]
                means[number, row, col] = mean if there[row, col] else means[number, row, col]


@compiled
def bounds(there: np.ndarray) -> tuple[int, int]:
    """Return the first row with a pixel that is asked for, and the row after the last."""
    rows, cols = there.shape
    top, bottom = rows, 0
    for row in range(rows):
        for col in range(cols):
            if there[row, col]:
                top, bottom = min(top, row), row + 1
    return top, bottom


@compiled
def weigh(fields: np.ndarray, number: int, weight: np.ndarray, row: int, held: np.ndarray) -> None:
    """Write each value of a row times its weight; what is not a number counts as 0."""
    for col in range(min(weight.shape[1], LONGEST)):
        value = fields[number, row, col] * weight[row, col]
        held[MARGIN_PX + row, MARGIN_PX + col] = value if abs(value) < np.inf else 0.0


@compiled
def sum_rows(held: np.ndarray, row: int, reach: int, line: np.ndarray) -> None:
    """Write the sum over the rows of the windows about a row, four and four beside its own."""
    own = MARGIN_PX + row
    for place in range(len(line)):
        line[place] = held[own, place]
    for near in range(1, reach, 2):
        for place in range(len(line)):
            above = held[own - near, place] + held[own - near - 1, place]
            line[place] += above + (held[own + near, place] + held[own + near + 1, place])


@compiled
def sum_columns(line: np.ndarray, reach: int, sums: np.ndarray) -> None:
    """Write the sum along a row, four and four beside its own: 2, 4, 8 or 16 on either side."""
    for col in range(min(len(sums), LONGEST)):
        sums[col] = line[col + MARGIN_PX]
    add_columns(line, 1, sums)
    if reach > 2:
        add_columns(line, 3, sums)
    if reach > 4:
        add_columns(line, 5, sums)
        add_columns(line, 7, sums)
    if reach > 8:
        add_columns(line, 9, sums)
        add_columns(line, 11, sums)
        add_columns(line, 13, sums)
        add_columns(line, 15, sums)


@compiled
def add_columns(line: np.ndarray, near: int, sums: np.ndarray) -> None:
    """Add what is so near along the row, and the next, on either side: a number that is known when this is compiled."""
    for col in range(min(len(sums), LONGEST)):
        before = line[col + MARGIN_PX - near] + line[col + MARGIN_PX - near - 1]
        sums[col] += before + (line[col + MARGIN_PX + near] + line[col + MARGIN_PX + near + 1])
