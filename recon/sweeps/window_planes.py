"""The planes through the pixels of a window about each, by running sums."""

import numpy as np
from jaxtyping import Float64

from recon.compiled import compiled

# A slope needs a few neighbours, and not all of them in one line.
FEWEST_NEIGHBOURS = 6
LEAST_DETERMINANT = 1e-6


def window_planes(value: np.ndarray, keep: np.ndarray, *, window_px: int) -> Float64[np.ndarray, "5 rows cols"]:
    """Return the plane through the kept pixels of each window: slopes by column and by row, height, mean square left, pixels.

    NaN where these are too few or in one line. ``value`` is zero where it is not kept.
    """
    planes = np.empty((5, *value.shape))
    write_planes(value, keep, window_px // 2, planes)
    return planes


@compiled
def write_planes(value: np.ndarray, keep: np.ndarray, half: int, planes: np.ndarray) -> None:
    """Write the plane through the kept pixels of the window about each, as ``window_planes`` returns it.

    Sums run along with the window, first down the columns and then along each row. Places in single precision leave double
    precision room for them, so that what is added and taken away again leaves nothing behind.
    """
    rows, cols = value.shape
    # Of each column: pixels, rows, squares of rows, values, rows times values, squares of values. Of each window in a row: the
    # same, and columns, squares of columns, columns times rows, columns times values.
    column, windows = np.zeros((6, cols)), np.empty((10, cols))
    for bottom in range(rows + half):
        for sign, row in ((1.0, bottom), (-1.0, bottom - 2 * half - 1)):
            if 0 <= row < rows:
                for col in range(cols):
                    if keep[row, col]:
                        column[0, col] += sign
                        column[1, col] += sign * row
                        column[2, col] += sign * row * row
                        column[3, col] += sign * value[row, col]
                        column[4, col] += sign * row * value[row, col]
                        column[5, col] += sign * value[row, col] * value[row, col]
        if bottom >= half:
            _write_windows(column, half, windows)
            _write_row(windows, bottom - half, planes)


@compiled
def _write_windows(column: np.ndarray, half: int, windows: np.ndarray) -> None:
    """Write the sums over each window of a row from those of its columns."""
    cols = column.shape[1]
    count = y = yy = v = yv = vv = x = xx = xy = xv = 0.0
    for right in range(cols + half):
        for sign, col in ((1.0, right), (-1.0, right - 2 * half - 1)):
            if 0 <= col < cols and column[0, col] > 0.0:
                count += sign * column[0, col]
                y += sign * column[1, col]
                yy += sign * column[2, col]
                v += sign * column[3, col]
                yv += sign * column[4, col]
                vv += sign * column[5, col]
                x += sign * col * column[0, col]
                xx += sign * col * col * column[0, col]
                xy += sign * col * column[1, col]
                xv += sign * col * column[3, col]
        if right >= half:
            at = right - half
            windows[0, at], windows[1, at], windows[2, at], windows[3, at], windows[4, at] = count, y, yy, v, yv
            windows[5, at], windows[6, at], windows[7, at], windows[8, at], windows[9, at] = vv, x, xx, xy, xv


@compiled
def _write_row(windows: np.ndarray, row: int, planes: np.ndarray) -> None:
    """Write the planes of a row; all are computed and some left out, so that a core makes several at once."""
    for col in range(windows.shape[1]):
        count, y, yy = windows[0, col], windows[1, col], windows[2, col]
        v, yv, vv, x = windows[3, col], windows[4, col], windows[5, col], windows[6, col]
        # About the mean of the window, and times the number of its pixels: all but those of values are whole numbers.
        xx, yy, xy = count * windows[7, col] - x * x, count * yy - y * y, count * windows[8, col] - x * y
        xv, yv, vv = count * windows[9, col] - x * v, count * yv - y * v, count * vv - v * v
        determinant = xx * yy - xy * xy
        known = (count >= FEWEST_NEIGHBOURS) & (determinant > LEAST_DETERMINANT * count * count)
        by_col, by_row = (yy * xv - xy * yv) / determinant, (xx * yv - xy * xv) / determinant
        height = (v + by_col * (count * col - x) + by_row * (count * row - y)) / count
        left = max(vv - by_col * xv - by_row * yv, 0.0) / (count * (count - 3))
        planes[0, row, col] = by_col if known else np.nan
        planes[1, row, col] = by_row if known else np.nan
        planes[2, row, col] = height if known else np.nan
        planes[3, row, col] = left if known else np.nan
        planes[4, row, col] = count if known else np.nan
