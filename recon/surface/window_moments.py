"""Compiled loops of the polynomials over square windows: moments of the heights, their sums over windows, and what follows.

Rows of numbers lie WIDTH apart in flat lines, and loops take COLUMNS of them, both known when they are compiled: then a core
takes several pixels at a time, and what a row of the map needs stays near it. Loops are given whole arrays and the numbers of
lines: taking a line out by itself would cost as much as the loop. Sums are taken term by term, since a running sum would leave
the rounding of large weights on small ones.

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
    readings, reach, layers = drawn.shape[1], half_widths[-1], FIELDS + TERMS * (len(draws) + 1)
    kept = np.zeros(KEPT_ROWS * layers * WIDTH)
    kept_layers = kept.reshape((KEPT_ROWS, layers, WIDTH))
    line, total = np.zeros((layers, WIDTH)), np.zeros((layers, WIDTH))
    work = np.zeros(WORK * WIDTH)
    lines = work.reshape((WORK, WIDTH))
    for row in range(-reach, rows):
        below = row + reach
        if below < rows:
            write_given(p, q, weight, height, below, lines)
            first = (below % KEPT_ROWS) * layers * WIDTH
            write_moments(work, kept[first : first + layers * WIDTH])
            write_fields(draws, below, lines, kept_layers, below % KEPT_ROWS)
        if row < 0:
            continue
        inner = 0
        for window in range(len(half_widths)):
            sum_rows(kept_layers, row, rows, inner, half_widths[window], line)
            sum_columns(line, half_widths[window], total)
            inner = half_widths[window]
            factorise(total, lines)
            solve_height(total, lines)
            meet(start, row, sight, lines)
            for col in range(cols):
                found[window, ALONG, row, col] = lines[MET + 2, col]
                found[window, SLOPE_P, row, col], found[window, SLOPE_Q, row, col] = (
                    lines[SLOPES, col],
                    lines[SLOPES + 1, col],
                )
                found[window, MISFIT, row, col] = lines[MISFITS, col]
                found[window, COUNTED, row, col] = total[COUNT, MARGIN_PX + col]
            for term in range(TERMS):
                for col in range(cols):
                    coefficients[window, term, row, col] = lines[COEFFICIENTS + term, col]
            for reading in range(readings):
                write_right(reading, lines)
                solve_right(lines, RIGHT + TERMS * reading)
                for col in range(cols):
                    variance[window, reading, row, col] = lines[READ, col]
            for col in range(COLUMNS):
                lines[MISFITS, col] = total[DRAWN_SQUARES, MARGIN_PX + col]
            for number in range(len(draws)):
                solve_draw(total, FIELDS + TERMS * (number + 1), work)
                for reading in range(readings):
                    read(work, lines, RIGHT + TERMS * reading, drawn, window, reading, number, row)
            for col in range(cols):
                found[window, DRAWN_MISFIT, row, col] = max(lines[MISFITS, col], 0.0) / max(len(draws), 1)


@compiled
def write_given(
    p: np.ndarray, q: np.ndarray, weight: np.ndarray, height: np.ndarray, row: int, lines: np.ndarray
) -> None:
    """Write a row of the places, weights and heights into the first four lines, with zeros after it."""
    for number in range(4):
        for col in range(COLUMNS):
            lines[number, col] = 0.0
    for col in range(p.shape[1]):
        lines[0, col], lines[1, col] = p[row, col], q[row, col]
        lines[2, col], lines[3, col] = weight[row, col], height[row, col]


@compiled
def write_moments(work: np.ndarray, moments: np.ndarray) -> None:
    """Write the moments of a row's pixels without heights, and their squares."""
    for col in range(COLUMNS):
        at, x, y, w, h = MARGIN_PX + col, work[col], work[WIDTH + col], work[2 * WIDTH + col], work[3 * WIDTH + col]
        xx, xy, yy = x * x, x * y, y * y
        moments[at], moments[WIDTH + at], moments[2 * WIDTH + at] = w, w * x, w * y
        moments[3 * WIDTH + at], moments[4 * WIDTH + at], moments[5 * WIDTH + at] = w * xx, w * xy, w * yy
        moments[6 * WIDTH + at], moments[7 * WIDTH + at] = w * xx * x, w * xx * y
        moments[8 * WIDTH + at], moments[9 * WIDTH + at] = w * x * yy, w * yy * y
        moments[10 * WIDTH + at], moments[11 * WIDTH + at] = w * xx * xx, w * xx * xy
        moments[12 * WIDTH + at], moments[13 * WIDTH + at] = w * xx * yy, w * xy * yy
        moments[14 * WIDTH + at] = w * yy * yy
        moments[COUNT * WIDTH + at] = 1.0 if w > 0 else 0.0
        moments[SQUARE * WIDTH + at] = w * h * h
        moments[DRAWN_SQUARES * WIDTH + at] = 0.0


@compiled
def write_fields(draws: np.ndarray, row: int, lines: np.ndarray, kept: np.ndarray, place: int) -> None:
    """Write the products of the height and of the draws with the weighted terms."""
    for number in range(len(draws) + 1):
        if number > 0:
            for col in range(draws.shape[2]):
                lines[3, col] = draws[number - 1, row, col]
            for col in range(COLUMNS):
                kept[place, DRAWN_SQUARES, MARGIN_PX + col] += lines[2, col] * lines[3, col] * lines[3, col]
        for term in range(TERMS):
            for col in range(COLUMNS):
                own = kept[place, term, MARGIN_PX + col] * lines[3, col]
                kept[place, FIELDS + TERMS * number + term, MARGIN_PX + col] = own


@compiled
def sum_rows(kept: np.ndarray, row: int, rows: int, inner: int, outer: int, line: np.ndarray) -> None:
    """Make of the sum over the rows of a window of half-width ``inner``, none for 0, that of ``outer``, within the map."""
    for layer in range(len(line)):
        if inner == 0:
            for col in range(WIDTH):
                line[layer, col] = kept[row % KEPT_ROWS, layer, col]
        for offset in range(inner + 1, outer + 1):
            above, below = (row - offset) % KEPT_ROWS, (row + offset) % KEPT_ROWS
            if row >= offset and row + offset < rows:
                for col in range(WIDTH):
                    line[layer, col] += kept[above, layer, col] + kept[below, layer, col]
            elif row >= offset:
                for col in range(WIDTH):
                    line[layer, col] += kept[above, layer, col]
            elif row + offset < rows:
                for col in range(WIDTH):
                    line[layer, col] += kept[below, layer, col]


@compiled
def sum_columns(line: np.ndarray, half_width: int, total: np.ndarray) -> None:
    """Sum each layer along the row."""
    for layer in range(len(line)):
        for at in range(MARGIN_PX, MARGIN_PX + COLUMNS):
            total[layer, at] = line[layer, at] + (line[layer, at - 1] + line[layer, at + 1])
        if half_width > 1:
            for at in range(MARGIN_PX, MARGIN_PX + COLUMNS):
                total[layer, at] += line[layer, at - 2] + line[layer, at + 2]
        if half_width > 2:
            for at in range(MARGIN_PX, MARGIN_PX + COLUMNS):
                total[layer, at] += line[layer, at - 3] + line[layer, at + 3]
        if half_width > 3:
            for at in range(MARGIN_PX, MARGIN_PX + COLUMNS):
                total[layer, at] += line[layer, at - 4] + line[layer, at + 4]


@compiled
def factorise(total: np.ndarray, lines: np.ndarray) -> None:
    """Factorise the normal matrix of every pixel (Cholesky)."""
    for col in range(COLUMNS):
        lines[READ, col] = TINY
    for term in range(TERMS):
        for col in range(COLUMNS):
            lines[READ, col] += RIDGE * total[ELEMENTS[term * (term + 3) // 2], MARGIN_PX + col]
    for first in range(TERMS):
        start = first * (first + 1) // 2
        for second in range(first + 1):
            here, other = start + second, second * (second + 1) // 2
            for col in range(COLUMNS):
                lines[here, col] = total[ELEMENTS[here], MARGIN_PX + col]
            for k in range(second):
                subtract_product(lines, here, start + k, other + k)
            if second < first:
                multiply(lines, here, other + second)
        for col in range(COLUMNS):
            lines[start + first, col] = 1.0 / np.sqrt(max(lines[start + first, col], lines[READ, col]))


@compiled
def solve_height(total: np.ndarray, lines: np.ndarray) -> None:
    """Write the polynomial's coefficients, and what it leaves of the squares of the height."""
    for col in range(COLUMNS):
        lines[MISFITS, col] = total[SQUARE, MARGIN_PX + col]
    for term in range(TERMS):
        here, start = COEFFICIENTS + term, term * (term + 1) // 2
        for col in range(COLUMNS):
            lines[here, col] = total[FIELDS + term, MARGIN_PX + col]
        for k in range(term):
            subtract_product(lines, here, start + k, COEFFICIENTS + k)
        multiply(lines, here, start + term)
        subtract_product(lines, MISFITS, here, here)
    for term in range(TERMS - 1, -1, -1):
        for k in range(term + 1, TERMS):
            subtract_product(lines, COEFFICIENTS + term, k * (k + 1) // 2 + term, COEFFICIENTS + k)
        multiply(lines, COEFFICIENTS + term, term * (term + 3) // 2)


@compiled
def subtract_product(lines: np.ndarray, result: int, one: int, other: int) -> None:
    """Take the product of two lines from a third, in place."""
    for col in range(COLUMNS):
        lines[result, col] -= lines[one, col] * lines[other, col]


@compiled
def multiply(lines: np.ndarray, result: int, factor: int) -> None:
    """Multiply one line by another, in place."""
    for col in range(COLUMNS):
        lines[result, col] *= lines[factor, col]


@compiled
def meet(start: np.ndarray, row: int, sight: np.ndarray, lines: np.ndarray) -> None:
    """Let the line through each start along the sight meet the pixel's polynomial (Newton), and write the slopes there."""
    for col in range(start.shape[1]):
        c0, c1, c2 = lines[COEFFICIENTS, col], lines[COEFFICIENTS + 1, col], lines[COEFFICIENTS + 2, col]
        c3, c4, c5 = lines[COEFFICIENTS + 3, col], lines[COEFFICIENTS + 4, col], lines[COEFFICIENTS + 5, col]
        x, y, along = start[row, col, 0], start[row, col, 1], 0.0
        slope_p, slope_q = c1 + 2 * c3 * x + c4 * y, c2 + c4 * x + 2 * c5 * y
        for _ in range(NEWTON_STEPS):
            rate = sight[2] - slope_p * sight[0] - slope_q * sight[1]
            if abs(rate) <= SLOWEST:
                rate = np.copysign(SLOWEST, rate)
            height = c0 + x * (c1 + c3 * x + c4 * y) + y * (c2 + c5 * y)
            along += (height - start[row, col, 2] - along * sight[2]) / rate
            x, y = start[row, col, 0] + along * sight[0], start[row, col, 1] + along * sight[1]
            slope_p, slope_q = c1 + 2 * c3 * x + c4 * y, c2 + c4 * x + 2 * c5 * y
        lines[MET, col], lines[MET + 1, col], lines[MET + 2, col] = x, y, along
        lines[SLOPES, col], lines[SLOPES + 1, col] = slope_p, slope_q


@compiled
def write_right(reading: int, lines: np.ndarray) -> None:
    """Write what a reading (0: value, 1: slope along p, 2: along q) takes of each coefficient where the polynomial is met."""
    first = RIGHT + TERMS * reading
    one, along, across = 1.0 if reading == 0 else 0.0, 1.0 if reading == 1 else 0.0, 1.0 if reading == 2 else 0.0
    for col in range(COLUMNS):
        p, q = lines[MET, col], lines[MET + 1, col]
        lines[first, col], lines[first + 1, col], lines[first + 2, col] = one, one * p + along, one * q + across
        lines[first + 3, col] = one * p * p + along * 2 * p
        lines[first + 4, col] = one * p * q + along * q + across * p
        lines[first + 5, col] = one * q * q + across * 2 * q


@compiled
def solve_right(lines: np.ndarray, first: int) -> None:
    """Replace what a reading takes by L⁻¹ times it, whose square is the variance for weights of one over variances.

    A window that knows nothing has pivots near zero, and a variance as good as infinite.
    """
    for col in range(COLUMNS):
        lines[READ, col] = 0.0
    for term in range(TERMS):
        here, start = first + term, term * (term + 1) // 2
        for k in range(term):
            subtract_product(lines, here, start + k, first + k)
        multiply(lines, here, start + term)
        for col in range(COLUMNS):
            lines[READ, col] += min(lines[here, col] * lines[here, col], LARGEST)
    for col in range(COLUMNS):
        lines[READ, col] = min(lines[READ, col], LARGEST)


@compiled
def solve_draw(total: np.ndarray, first: int, work: np.ndarray) -> None:
    """Write L⁻¹ times a draw's right side, and take its square from the draws' misfit."""
    for col in range(COLUMNS):
        at = MARGIN_PX + col
        h0 = total[first, at] * work[col]
        h1 = (total[first + 1, at] - work[WIDTH + col] * h0) * work[2 * WIDTH + col]
        h2 = total[first + 2, at] - work[3 * WIDTH + col] * h0 - work[4 * WIDTH + col] * h1
        h2 *= work[5 * WIDTH + col]
        h3 = total[first + 3, at] - work[6 * WIDTH + col] * h0 - work[7 * WIDTH + col] * h1
        h3 = (h3 - work[8 * WIDTH + col] * h2) * work[9 * WIDTH + col]
        h4 = total[first + 4, at] - work[10 * WIDTH + col] * h0 - work[11 * WIDTH + col] * h1
        h4 = (h4 - work[12 * WIDTH + col] * h2 - work[13 * WIDTH + col] * h3) * work[14 * WIDTH + col]
        h5 = total[first + 5, at] - work[15 * WIDTH + col] * h0 - work[16 * WIDTH + col] * h1
        h5 = h5 - work[17 * WIDTH + col] * h2 - work[18 * WIDTH + col] * h3 - work[19 * WIDTH + col] * h4
        h5 *= work[20 * WIDTH + col]
        work[SOLVED * WIDTH + col], work[(SOLVED + 1) * WIDTH + col], work[(SOLVED + 2) * WIDTH + col] = h0, h1, h2
        work[(SOLVED + 3) * WIDTH + col], work[(SOLVED + 4) * WIDTH + col] = h3, h4
        work[(SOLVED + 5) * WIDTH + col] = h5
        work[MISFITS * WIDTH + col] -= h0 * h0 + h1 * h1 + h2 * h2 + h3 * h3 + h4 * h4 + h5 * h5


@compiled
def read(
    work: np.ndarray,
    lines: np.ndarray,
    right: int,
    drawn: np.ndarray,
    window: int,
    reading: int,
    number: int,
    row: int,
) -> None:
    """Write a reading of the draw that was solved."""
    for col in range(min(drawn.shape[4], COLUMNS)):
        first = (
            lines[right, col] * work[SOLVED * WIDTH + col] + lines[right + 1, col] * work[(SOLVED + 1) * WIDTH + col]
        )
        second = lines[right + 2, col] * work[(SOLVED + 2) * WIDTH + col]
        second += lines[right + 3, col] * work[(SOLVED + 3) * WIDTH + col]
        third = lines[right + 4, col] * work[(SOLVED + 4) * WIDTH + col]
        third += lines[right + 5, col] * work[(SOLVED + 5) * WIDTH + col]
        drawn[window, reading, number, row, col] = first + second + third
