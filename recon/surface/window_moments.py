"""Compiled loops of the polynomials over square windows: moments of the heights, their sums over windows, and what follows.

Rows of numbers lie WIDTH apart in flat lines, and loops take COLUMNS of them, both known when they are compiled: then a core
takes several pixels at a time, and what a row of the map needs stays near it. Sums are taken term by term, since a running sum
would leave the rounding of large weights on small ones.

A pixel's moments are one layer each: the 15 different products of 1, p, q, p², pq, q² with each other, the count, the squares of
the height and of all draws, then the products of the six with the height and with each draw. All but the count are weighted.
"""

import numpy as np

from recon.compiled import compiled

TERMS = 6
# As many columns as a map may have.
COLUMNS = 72
# Beside them, so that a sum over columns takes none of the next layer: as many as a window may reach.
MARGIN_PX = 4
WIDTH = COLUMNS + 2 * MARGIN_PX
KEPT_ROWS = 2 * MARGIN_PX + 1
# The layers of moments. Which of the first 15 is which element of the normal matrix (its lower half, row by row) says the table.
COUNT, SQUARE, DRAWN_SQUARES, FIELDS = 15, 16, 17, 18
ELEMENTS = (0, 1, 3, 2, 4, 5, 3, 6, 7, 10, 4, 7, 8, 11, 12, 5, 8, 9, 12, 13, 14)
# So many layers are summed at a time: their sums, and what they are made of, stay in a core's nearest memory.
LAYERS_AT_ONCE = 6
# Keeps a window without six independent places solvable; its variance then tells that it knows nothing.
RIDGE = 1e-12
TINY = np.finfo(float).tiny
# Beyond this, a number is infinite for every purpose.
LARGEST = 1e100
NEWTON_STEPS = 4
# A line that leaves the polynomial more slowly meets it nowhere near.
SLOWEST = 1e-3
# Lines of work: the Cholesky factor L, row by row, with the inverse of its diagonal; the polynomial; a draw's L⁻¹ times its right
# side; the same of each reading; a line each of misfits and of what was read; where a pixel's line meets its polynomial
# (p, q, how far along), and the slopes there.
COEFFICIENTS, SOLVED, RIGHT, MISFITS, READ, MET, SLOPES, WORK = 21, 27, 33, 51, 52, 53, 56, 58
# What is found of a pixel: how far along its line the polynomial is met, the slopes there, and how well it fits.
ALONG, SLOPE_P, SLOPE_Q, MISFIT, COUNTED, DRAWN_MISFIT, FOUND = range(7)


@compiled
def fit_along_lines(
    p: np.ndarray,
    q: np.ndarray,
    height: np.ndarray,
    draws: np.ndarray,
    weight: np.ndarray,
    start: np.ndarray,
    sight: np.ndarray,
    half_widths: np.ndarray,
    coefficients: np.ndarray,
    found: np.ndarray,
    drawn: np.ndarray,
    variance: np.ndarray,
) -> None:
    """Fit a polynomial over the windows about every pixel, let the pixel's line meet it, and read the draws there.

    The windows grow. ``drawn`` [windows, readings, draws, rows, cols] has one reading or three: value, slopes along p and q.
    """
    rows, cols = p.shape
    readings = drawn.shape[1]
    kept = np.zeros((KEPT_ROWS, (FIELDS + TERMS * (len(draws) + 1)) * WIDTH))
    line, total = np.zeros(kept.shape[1] + 2 * MARGIN_PX), np.zeros(kept.shape[1])
    work = np.zeros(WORK * WIDTH)
    reach = half_widths[-1]
    for row in range(-reach, rows):
        if row + reach < rows:
            write_moments(p, q, height, draws, weight, row + reach, kept[(row + reach) % KEPT_ROWS], work)
        if row < 0:
            continue
        copy(kept[row % KEPT_ROWS], line[MARGIN_PX:])
        inner = 0
        for window in range(len(half_widths)):
            sum_window(kept, row, rows, inner, half_widths[window], line, total)
            inner = half_widths[window]
            factorise(total, work)
            solve_height(total, work)
            meet(start[row], sight, work)
            for number, place in enumerate((MET + 2, SLOPES, SLOPES + 1, MISFITS)):
                copy(line_of(work, place)[:cols], found[window, number, row])
            copy(layer_of(total, COUNT)[:cols], found[window, COUNTED, row])
            for term in range(TERMS):
                copy(line_of(work, COEFFICIENTS + term)[:cols], coefficients[window, term, row])
            for reading in range(readings):
                write_right(reading, work)
                solve_right(work, RIGHT + TERMS * reading)
                copy(line_of(work, READ)[:cols], variance[window, reading, row])
            copy(layer_of(total, DRAWN_SQUARES), line_of(work, MISFITS))
            for number in range(len(draws)):
                first = (FIELDS + TERMS * (number + 1)) * WIDTH
                solve_draw(total[first : first + TERMS * WIDTH], work)
                for reading in range(readings):
                    right = work[(RIGHT + TERMS * reading) * WIDTH : (RIGHT + TERMS * (reading + 1)) * WIDTH]
                    read(right, work, drawn[window, reading, number, row])
            for col in range(cols):
                found[window, DRAWN_MISFIT, row, col] = max(work[MISFITS * WIDTH + col], 0.0) / max(len(draws), 1)


@compiled
def copy(values: np.ndarray, result: np.ndarray) -> None:
    """Copy values to the beginning of another line."""
    for place in range(len(values)):
        result[place] = values[place]


@compiled
def fill(line: np.ndarray, value: float) -> None:
    """Write one value everywhere."""
    for place in range(len(line)):
        line[place] = value


@compiled
def line_of(work: np.ndarray, number: int) -> np.ndarray:
    """Return a line of work."""
    return work[number * WIDTH : number * WIDTH + COLUMNS]


@compiled
def layer_of(moments: np.ndarray, number: int) -> np.ndarray:
    """Return a layer of a row's moments, without its margins."""
    return moments[number * WIDTH + MARGIN_PX : number * WIDTH + MARGIN_PX + COLUMNS]


@compiled
def write_moments(
    p: np.ndarray,
    q: np.ndarray,
    height: np.ndarray,
    draws: np.ndarray,
    weight: np.ndarray,
    row: int,
    moments: np.ndarray,
    work: np.ndarray,
) -> None:
    """Write the moments of a row's pixels, by way of the first four lines of work."""
    fill(work[: 4 * WIDTH], 0.0)
    copy(p[row], work)
    copy(q[row], line_of(work, 1))
    copy(weight[row], line_of(work, 2))
    copy(height[row], line_of(work, 3))
    for col in range(COLUMNS):
        at, x, y, w = MARGIN_PX + col, work[col], work[WIDTH + col], work[2 * WIDTH + col]
        xx, xy, yy = x * x, x * y, y * y
        moments[at], moments[WIDTH + at], moments[2 * WIDTH + at] = w, w * x, w * y
        moments[3 * WIDTH + at], moments[4 * WIDTH + at], moments[5 * WIDTH + at] = w * xx, w * xy, w * yy
        moments[6 * WIDTH + at], moments[7 * WIDTH + at] = w * xx * x, w * xx * y
        moments[8 * WIDTH + at], moments[9 * WIDTH + at] = w * x * yy, w * yy * y
        moments[10 * WIDTH + at], moments[11 * WIDTH + at], moments[12 * WIDTH + at] = (
            w * xx * xx,
            w * xx * xy,
            w * xx * yy,
        )
        moments[13 * WIDTH + at], moments[14 * WIDTH + at] = w * xy * yy, w * yy * yy
        moments[COUNT * WIDTH + at] = 1.0 if w > 0 else 0.0
        moments[SQUARE * WIDTH + at] = w * work[3 * WIDTH + col] * work[3 * WIDTH + col]
        moments[DRAWN_SQUARES * WIDTH + at] = 0.0
    write_field(moments, work, FIELDS)
    for number in range(len(draws)):
        copy(draws[number, row], line_of(work, 3))
        add_square(layer_of(moments, DRAWN_SQUARES), line_of(work, 2), line_of(work, 3))
        write_field(moments, work, FIELDS + TERMS * (number + 1))


@compiled
def write_field(moments: np.ndarray, work: np.ndarray, first: int) -> None:
    """Write the products of the fourth line of work, a height or a draw, with the weighted terms."""
    for term in range(TERMS):
        own, terms, values = layer_of(moments, first + term), layer_of(moments, term), line_of(work, 3)
        for col in range(COLUMNS):
            own[col] = terms[col] * values[col]


@compiled
def add_square(total: np.ndarray, weight: np.ndarray, values: np.ndarray) -> None:
    """Add a line's weighted squares to another, in place."""
    for col in range(COLUMNS):
        total[col] += weight[col] * values[col] * values[col]


@compiled
def sum_window(
    kept: np.ndarray, row: int, rows: int, inner: int, outer: int, line: np.ndarray, total: np.ndarray
) -> None:
    """Sum a row of moments over the window of half-width ``outer``, as far as it is within the map.

    ``line`` is the sum over the rows of the ``inner`` one, with a margin of zeros at either end, and has that of the outer one
    afterwards. Several layers are summed as one line, from which the margins keep them apart.
    """
    for first in range(0, len(total), LAYERS_AT_ONCE * WIDTH):
        last = min(first + LAYERS_AT_ONCE * WIDTH, len(total))
        middle, here = line[MARGIN_PX + first : MARGIN_PX + last], total[first:last]
        for offset in range(inner + 1, outer + 1):
            above, below = kept[(row - offset) % KEPT_ROWS], kept[(row + offset) % KEPT_ROWS]
            if row >= offset and row + offset < rows:
                add_both(middle, above[first:last], below[first:last])
            elif row >= offset:
                add(middle, above[first:last])
            elif row + offset < rows:
                add(middle, below[first:last])
        copy(middle, here)
        for offset in range(1, outer + 1):
            add_both(here, line[MARGIN_PX + first - offset :], line[MARGIN_PX + first + offset :])


@compiled
def add(total: np.ndarray, more: np.ndarray) -> None:
    """Add one line to another, in place."""
    for place in range(len(total)):
        total[place] += more[place]


@compiled
def add_both(total: np.ndarray, one: np.ndarray, other: np.ndarray) -> None:
    """Add the beginnings of two lines to a third, in place."""
    for place in range(len(total)):
        total[place] += one[place] + other[place]


@compiled
def factorise(total: np.ndarray, work: np.ndarray) -> None:
    """Factorise the normal matrix of every pixel (Cholesky)."""
    ridge = line_of(work, READ)
    fill(ridge, TINY)
    for term in range(TERMS):
        own = layer_of(total, ELEMENTS[term * (term + 3) // 2])
        for col in range(COLUMNS):
            ridge[col] += RIDGE * own[col]
    for first in range(TERMS):
        start = first * (first + 1) // 2
        for second in range(first + 1):
            here, other = line_of(work, start + second), second * (second + 1) // 2
            copy(layer_of(total, ELEMENTS[start + second]), here)
            for k in range(second):
                subtract_product(here, line_of(work, start + k), line_of(work, other + k))
            if second < first:
                multiply(here, line_of(work, other + second))
        for col in range(COLUMNS):
            here[col] = 1.0 / np.sqrt(max(here[col], ridge[col]))


@compiled
def solve_height(total: np.ndarray, work: np.ndarray) -> None:
    """Write the polynomial's coefficients, and what it leaves of the squares of the height."""
    misfit = line_of(work, MISFITS)
    copy(layer_of(total, SQUARE), misfit)
    for term in range(TERMS):
        here, start = line_of(work, COEFFICIENTS + term), term * (term + 1) // 2
        copy(layer_of(total, FIELDS + term), here)
        for k in range(term):
            subtract_product(here, line_of(work, start + k), line_of(work, COEFFICIENTS + k))
        multiply(here, line_of(work, start + term))
        subtract_product(misfit, here, here)
    for term in range(TERMS - 1, -1, -1):
        here = line_of(work, COEFFICIENTS + term)
        for k in range(term + 1, TERMS):
            subtract_product(here, line_of(work, k * (k + 1) // 2 + term), line_of(work, COEFFICIENTS + k))
        multiply(here, line_of(work, term * (term + 3) // 2))


@compiled
def subtract_product(result: np.ndarray, one: np.ndarray, other: np.ndarray) -> None:
    """Take the product of two lines from a third, in place."""
    for col in range(COLUMNS):
        result[col] -= one[col] * other[col]


@compiled
def multiply(result: np.ndarray, factor: np.ndarray) -> None:
    """Multiply one line by another, in place."""
    for col in range(COLUMNS):
        result[col] *= factor[col]


@compiled
def meet(start: np.ndarray, sight: np.ndarray, work: np.ndarray) -> None:
    """Let the line through each start along the sight meet the pixel's polynomial (Newton), and write the slopes there."""
    for col in range(len(start)):
        c0, c1, c2 = (
            work[COEFFICIENTS * WIDTH + col],
            work[(COEFFICIENTS + 1) * WIDTH + col],
            work[(COEFFICIENTS + 2) * WIDTH + col],
        )
        c3, c4, c5 = (
            work[(COEFFICIENTS + 3) * WIDTH + col],
            work[(COEFFICIENTS + 4) * WIDTH + col],
            work[(COEFFICIENTS + 5) * WIDTH + col],
        )
        x, y, along = start[col, 0], start[col, 1], 0.0
        slope_p, slope_q = c1 + 2 * c3 * x + c4 * y, c2 + c4 * x + 2 * c5 * y
        for _ in range(NEWTON_STEPS):
            rate = sight[2] - slope_p * sight[0] - slope_q * sight[1]
            if abs(rate) <= SLOWEST:
                rate = np.copysign(SLOWEST, rate)
            height = c0 + x * (c1 + c3 * x + c4 * y) + y * (c2 + c5 * y)
            along += (height - start[col, 2] - along * sight[2]) / rate
            x, y = start[col, 0] + along * sight[0], start[col, 1] + along * sight[1]
            slope_p, slope_q = c1 + 2 * c3 * x + c4 * y, c2 + c4 * x + 2 * c5 * y
        work[MET * WIDTH + col], work[(MET + 1) * WIDTH + col], work[(MET + 2) * WIDTH + col] = x, y, along
        work[SLOPES * WIDTH + col], work[(SLOPES + 1) * WIDTH + col] = slope_p, slope_q


@compiled
def write_right(reading: int, work: np.ndarray) -> None:
    """Write what a reading (0: value, 1: slope along p, 2: along q) takes of each coefficient where the polynomial is met."""
    right = work[(RIGHT + TERMS * reading) * WIDTH : (RIGHT + TERMS * (reading + 1)) * WIDTH]
    for col in range(COLUMNS):
        p, q = work[MET * WIDTH + col], work[(MET + 1) * WIDTH + col]
        one, along, across = 1.0 if reading == 0 else 0.0, 1.0 if reading == 1 else 0.0, 1.0 if reading == 2 else 0.0
        right[col] = one
        right[WIDTH + col] = one * p + along
        right[2 * WIDTH + col] = one * q + across
        right[3 * WIDTH + col] = one * p * p + along * 2 * p
        right[4 * WIDTH + col] = one * p * q + along * q + across * p
        right[5 * WIDTH + col] = one * q * q + across * 2 * q


@compiled
def solve_right(work: np.ndarray, first: int) -> None:
    """Replace what a reading takes by L⁻¹ times it, whose square is the variance for weights of one over variances.

    A window that knows nothing has pivots near zero, and a variance as good as infinite.
    """
    variance = line_of(work, READ)
    fill(variance, 0.0)
    for term in range(TERMS):
        here, start = line_of(work, first + term), term * (term + 1) // 2
        for k in range(term):
            subtract_product(here, line_of(work, start + k), line_of(work, first + k))
        multiply(here, line_of(work, start + term))
        for col in range(COLUMNS):
            variance[col] += min(here[col] * here[col], LARGEST)
    for col in range(COLUMNS):
        variance[col] = min(variance[col], LARGEST)


@compiled
def solve_draw(right: np.ndarray, work: np.ndarray) -> None:
    """Write L⁻¹ times a draw's right side, and take its square from the draws' misfit."""
    for col in range(COLUMNS):
        at = MARGIN_PX + col
        h0 = right[at] * work[col]
        h1 = (right[WIDTH + at] - work[WIDTH + col] * h0) * work[2 * WIDTH + col]
        h2 = right[2 * WIDTH + at] - work[3 * WIDTH + col] * h0 - work[4 * WIDTH + col] * h1
        h2 *= work[5 * WIDTH + col]
        h3 = right[3 * WIDTH + at] - work[6 * WIDTH + col] * h0 - work[7 * WIDTH + col] * h1
        h3 = (h3 - work[8 * WIDTH + col] * h2) * work[9 * WIDTH + col]
        h4 = right[4 * WIDTH + at] - work[10 * WIDTH + col] * h0 - work[11 * WIDTH + col] * h1
        h4 = (h4 - work[12 * WIDTH + col] * h2 - work[13 * WIDTH + col] * h3) * work[14 * WIDTH + col]
        h5 = right[5 * WIDTH + at] - work[15 * WIDTH + col] * h0 - work[16 * WIDTH + col] * h1
        h5 = h5 - work[17 * WIDTH + col] * h2 - work[18 * WIDTH + col] * h3 - work[19 * WIDTH + col] * h4
        h5 *= work[20 * WIDTH + col]
        work[SOLVED * WIDTH + col], work[(SOLVED + 1) * WIDTH + col], work[(SOLVED + 2) * WIDTH + col] = h0, h1, h2
        work[(SOLVED + 3) * WIDTH + col], work[(SOLVED + 4) * WIDTH + col], work[(SOLVED + 5) * WIDTH + col] = (
            h3,
            h4,
            h5,
        )
        work[MISFITS * WIDTH + col] -= h0 * h0 + h1 * h1 + h2 * h2 + h3 * h3 + h4 * h4 + h5 * h5


@compiled
def read(right: np.ndarray, work: np.ndarray, result: np.ndarray) -> None:
    """Write a reading of the draw that was solved."""
    for col in range(min(len(result), COLUMNS)):
        first = right[col] * work[SOLVED * WIDTH + col] + right[WIDTH + col] * work[(SOLVED + 1) * WIDTH + col]
        second = (
            right[2 * WIDTH + col] * work[(SOLVED + 2) * WIDTH + col]
            + right[3 * WIDTH + col] * work[(SOLVED + 3) * WIDTH + col]
        )
        third = (
            right[4 * WIDTH + col] * work[(SOLVED + 4) * WIDTH + col]
            + right[5 * WIDTH + col] * work[(SOLVED + 5) * WIDTH + col]
        )
        result[col] = first + second + third
