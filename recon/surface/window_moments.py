"""Compiled loops of the polynomials over square windows: moments of the heights, their sums over windows, and what follows.

Every loop runs along a row of the map, so that a core does several pixels at a time, and where it can along all of its layers.
Sums are taken term by term, since a running sum would leave the rounding of large weights on small ones; those over three pixels
are kept, and make those over nine.
"""

import numpy as np

from recon.compiled import compiled

TERMS = 6
PAIRS = TERMS * (TERMS + 1) // 2
# Above and below the map, so that a window of three about a pixel just outside can be asked for.
BORDER_PX = 1
# Beside it, so that a sum over columns takes none of the next layer: as many as offsets may reach.
MARGIN_PX = 4
# Keeps a window without six independent places solvable; its variance then tells that it knows nothing.
RIDGE = 1e-12
TINY = np.finfo(float).tiny
# Beyond this, a number is infinite for every purpose.
LARGEST = 1e100


def layers_of(fields: int) -> int:
    """Return how many moments a pixel has, with so many fields of heights.

    They are the 21 products of 1, p, q, p², pq, q² (lower half of a symmetric matrix, row by row), the count, the six products
    of these with each field (term by term), and each field's square; all but the count are weighted.
    """
    return PAIRS + 1 + (TERMS + 1) * fields


@compiled
def write_moments(p: np.ndarray, q: np.ndarray, fields: np.ndarray, weight: np.ndarray, layers: np.ndarray) -> None:
    """Write every pixel's own moments into the layers [rows, layers, cols] within a border, which are 0 before."""
    rows, cols = p.shape
    terms, weighted = np.ones((TERMS, cols)), np.empty((TERMS, cols))
    for row in range(rows):
        own = layers[row + BORDER_PX, :, MARGIN_PX : MARGIN_PX + cols]
        for col in range(cols):
            along, down = p[row, col], q[row, col]
            terms[1, col], terms[2, col] = along, down
            terms[3, col], terms[4, col], terms[5, col] = along * along, along * down, down * down
        for term in range(TERMS):
            for col in range(cols):
                weighted[term, col] = weight[row, col] * terms[term, col]
        place = 0
        for first in range(TERMS):
            for second in range(first + 1):
                for col in range(cols):
                    own[place, col] = weighted[first, col] * terms[second, col]
                place += 1
        for col in range(cols):
            own[place, col] = 1.0 if weight[row, col] > 0 else 0.0
        place += 1
        for term in range(TERMS):
            for number in range(len(fields)):
                for col in range(cols):
                    own[place, col] = weighted[term, col] * fields[number, row, col]
                place += 1
        for number in range(len(fields)):
            for col in range(cols):
                own[place, col] = weighted[0, col] * fields[number, row, col] ** 2
            place += 1


@compiled
def sum_row(layers: np.ndarray, row: int, offsets: np.ndarray, line: np.ndarray, total: np.ndarray) -> None:
    """Sum one row of the layers over rows and columns at these offsets from each pixel, as far as they are within the layers.

    All layers of a row are summed as one line, from which the margins keep them apart. ``line`` is room for the sum over rows,
    with MARGIN_PX zeros at either end.
    """
    rows, count, cols = layers.shape
    length = count * cols
    middle, here = line[MARGIN_PX : MARGIN_PX + length], total.reshape(length)
    middle[:] = 0.0
    for offset in offsets:
        if 0 <= row + offset < rows:
            add_to(middle, layers[row + offset].reshape(length))
    here[:] = 0.0
    for offset in offsets:
        add_to(here, line[MARGIN_PX + offset : MARGIN_PX + offset + length])


@compiled
def add_to(total: np.ndarray, more: np.ndarray) -> None:
    """Add one line to another, in place."""
    for place in range(len(total)):
        total[place] += more[place]


@compiled
def sum_windows(layers: np.ndarray, offsets: np.ndarray, result: np.ndarray) -> None:
    """Sum all rows as :func:`sum_row` does one."""
    rows, count, cols = layers.shape
    line = np.zeros(count * cols + 2 * MARGIN_PX)
    for row in range(rows):
        sum_row(layers, row, offsets, line, result[row])


@compiled
def fit_windows_of(
    layers: np.ndarray,
    offsets: np.ndarray,
    coefficients: np.ndarray,
    factor: np.ndarray,
    misfit: np.ndarray,
    count: np.ndarray,
    drawn: np.ndarray,
    drawn_misfit: np.ndarray,
) -> None:
    """Sum moments at these offsets, factorise the normal matrix of every pixel (Cholesky), and solve for the heights.

    The right sides of the draws are solved half way. All pixels of a row take each step together.
    """
    rows, cols = misfit.shape
    draws = len(drawn_misfit)
    ridge = np.empty(cols)
    line, total = np.zeros(layers.shape[1] * layers.shape[2] + 2 * MARGIN_PX), np.empty(layers.shape[1:])
    own = total[:, MARGIN_PX : MARGIN_PX + cols]
    for row in range(rows):
        sum_row(layers, row + BORDER_PX, offsets, line, total)
        lower, half, own_misfit = factor[row], drawn[row], misfit[row]
        lower[:] = own[:PAIRS]
        ridge[:] = TINY
        count[row] = own[PAIRS]
        own_misfit[:] = own[PAIRS + 1 + TERMS * (draws + 1)]
        for number in range(draws):
            drawn_misfit[number, row] = own[PAIRS + 2 + TERMS * (draws + 1) + number]
        for term in range(TERMS):
            diagonal = lower[term * (term + 3) // 2]
            for col in range(cols):
                ridge[col] += RIDGE * diagonal[col]
        for first in range(TERMS):
            start = first * (first + 1) // 2
            for second in range(first):
                other = second * (second + 1) // 2
                for k in range(second):
                    subtract_product(lower[start + second], lower[start + k], lower[other + k])
                for col in range(cols):
                    lower[start + second, col] /= lower[other + second, col]
            pivot, place = lower[start + first], PAIRS + 1 + first * (draws + 1)
            for k in range(first):
                subtract_product(pivot, lower[start + k], lower[start + k])
            for col in range(cols):
                pivot[col] = np.sqrt(max(pivot[col], ridge[col]))
            coefficients[first, row] = own[place]
            for k in range(first):
                subtract_product(coefficients[first, row], lower[start + k], coefficients[k, row])
            for col in range(cols):
                coefficients[first, row, col] /= pivot[col]
            subtract_product(own_misfit, coefficients[first, row], coefficients[first, row])
            half[first] = own[place + 1 : place + 1 + draws]
            for k in range(first):
                subtract_products(half[first], lower[start + k], half[k])
            finish_term(half[first], pivot, drawn_misfit[:, row])
        for first in range(TERMS - 1, -1, -1):
            for k in range(first + 1, TERMS):
                subtract_product(coefficients[first, row], lower[k * (k + 1) // 2 + first], coefficients[k, row])
            diagonal = lower[first * (first + 3) // 2]
            for col in range(cols):
                coefficients[first, row, col] /= diagonal[col]


@compiled
def subtract_product(result: np.ndarray, one: np.ndarray, other: np.ndarray) -> None:
    """Take the product of two rows from a third, in place."""
    for col in range(len(result)):
        result[col] -= one[col] * other[col]


@compiled
def subtract_products(result: np.ndarray, one: np.ndarray, other: np.ndarray) -> None:
    """Take the product of a row and each of some rows from each of some others, in place."""
    for number in range(len(result)):
        for col in range(len(one)):
            result[number, col] -= one[col] * other[number, col]


@compiled
def finish_term(half: np.ndarray, pivot: np.ndarray, misfit: np.ndarray) -> None:
    """Divide a term of every draw by the pivot, and take its square from the draw's misfit."""
    for number in range(len(half)):
        for col in range(len(pivot)):
            half[number, col] /= pivot[col]
            misfit[number, col] -= half[number, col] * half[number, col]


@compiled
def read_draws(
    factor: np.ndarray, drawn: np.ndarray, right: np.ndarray, values: np.ndarray, variance: np.ndarray
) -> None:
    """Write the sum with the factors ``right`` of each draw's coefficients, and the square of L⁻¹ ``right``.

    A window that knows nothing has pivots near zero, and a variance as good as infinite.
    """
    draws, rows, cols = values.shape
    half = np.empty((TERMS, cols))
    for row in range(rows):
        variance[row] = 0.0
        values[:, row] = 0.0
        for first in range(TERMS):
            start = first * (first + 1) // 2
            half[first] = right[first, row]
            for k in range(first):
                subtract_product(half[first], factor[row, start + k], half[k])
            for col in range(cols):
                half[first, col] /= factor[row, start + first, col]
                variance[row, col] += min(half[first, col] ** 2, LARGEST)
            for number in range(draws):
                here, other = values[number, row], drawn[row, first, number]
                for col in range(cols):
                    here[col] += half[first, col] * other[col]
        for col in range(cols):
            variance[row, col] = min(variance[row, col], LARGEST)
