"""How the surface bends about each pixel: the change of the normals over the points, by least squares over a window.

A light path that is off by noise meets the surface beside the place that the pixel's other measurements belong to. There the
normal is another one, and the surface lies below the tangent plane: both by the curvature.
"""

import numpy as np
from jaxtyping import Float32

from recon.bands import over_bands
from recon.compiled import compiled
from recon.surface.ray_chords import Mask, VectorMap

WINDOW_PX = 9
# Share of a window's spread that no direction falls short of: a line of pixels says nothing across itself.
LINE = 1e-3
# A cut window's bend is followed out to its pixel by the difference to those about it, so many times at most. Where that would
# change it by more than a quarter, squared, a crease or noise speaks, and no even change.
FARTHEST, LARGEST_SQUARE = 2.0, 0.25**2
# Sums over a window: the count, three of places, three of normals, nine of places by places, nine of normals by places.
SUMS = 25
TINY = np.finfo(float).tiny
# Single precision is far finer than what a window tells.
Tensors = Float32[np.ndarray, "rows cols 3 3"]


def curvature_of(point_mm: VectorMap, normal: VectorMap, used: Mask, *, threads: int = 1) -> Tensors:
    """Return K in 1/mm, tangential, so that a step d along the surface turns the normal by K d; 0 outside the mask.

    A window tells the bend at its middle. That of a pixel at the rim is two pixels farther in, where the surface may bend less by
    a fifth. So many ``threads`` share the rows.
    """
    result, size = np.zeros((*used.shape, 3, 3), np.float32), np.zeros(used.shape)
    cut = np.zeros(used.shape, dtype=bool)
    if used.any():
        mean_point = point_mm[used].mean(axis=0)
        point_mm, normal = np.ascontiguousarray(point_mm), np.ascontiguousarray(normal)
        least = 0.0

        def write(band: slice) -> None:
            _curvatures(point_mm, normal, used, mean_point, least, band.start, band.stop, result, size, cut)

        over_bands(write, len(used), threads=threads)
        least = LINE * float(np.median(size[used]))
        # A lone pixel spreads over nothing, and shows no bend.
        if (size[used] < least).any():
            over_bands(write, len(used), threads=threads)
        numbers = np.flatnonzero(cut)
        change = np.zeros((len(numbers), 3, 3))
        _write_changes(result, used, cut, numbers, change)
        result.reshape(-1, 3, 3)[numbers] += change
    return result


@compiled
def _curvatures(
    point: np.ndarray,
    normal: np.ndarray,
    used: np.ndarray,
    mean_point: np.ndarray,
    least: float,
    first: int,
    end: int,
    result: np.ndarray,
    size: np.ndarray,
    cut: np.ndarray,
) -> None:
    """Write the curvature of every used pixel of the rows from ``first`` to before ``end``.

    Beside it, over what area its window spreads, which counts as ``least`` at least, and whether it is cut.
    """
    rows, cols = used.shape
    reach = WINDOW_PX // 2
    ring, line, total = np.zeros((WINDOW_PX, SUMS, cols)), np.zeros(cols + 2 * reach), np.zeros((SUMS, cols))
    spread, shared, tangents = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3))
    for ahead in range(max(first - reach, 0), end + reach):
        products = ring[ahead % WINDOW_PX]
        products[:] = 0.0
        if ahead < rows:
            _write_products(point[ahead], normal[ahead], used[ahead], mean_point, products)
        row = ahead - reach
        if row < first or not used[row].any():
            continue
        for one in range(SUMS):
            middle, here = line[reach : reach + cols], total[one]
            middle[:] = 0.0
            for slot in range(WINDOW_PX):
                middle += ring[slot, one]
            here[:] = 0.0
            for offset in range(WINDOW_PX):
                here += line[offset : offset + cols]
        for col in range(cols):
            if used[row, col]:
                count = total[0, col]
                for k in range(3):
                    for j in range(3):
                        spread[k, j] = total[7 + 3 * k + j, col] - total[1 + k, col] * total[1 + j, col] / count
                        shared[k, j] = total[16 + 3 * k + j, col] - total[4 + k, col] * total[1 + j, col] / count
                _write_tangents(total[4, col], total[5, col], total[6, col], tangents)
                cut[row, col] = count < WINDOW_PX**2
                size[row, col] = _write_bend(spread, shared, tangents, count, least, result[row, col])


@compiled
def _write_changes(
    told: np.ndarray, used: np.ndarray, cut: np.ndarray, numbers: np.ndarray, change: np.ndarray
) -> None:
    """Write by how much the bend at the pixels whose windows are ``cut`` differs from what these ``told`` of their middles.

    With a bend that changes evenly from the pixel inwards, K = K_w + (K_w − M) |m − x| / |m' − m|, where m is the middle of the
    pixel's own window, and m' and M the means of the middles and of the bends of the windows about x.
    """
    rows, cols = used.shape
    reach = WINDOW_PX // 2
    middle = np.empty((rows, cols, 2), np.float32)
    for row in range(rows):
        for col in range(cols):
            middle[row, col, 0], middle[row, col, 1] = row, col
            if not cut[row, col]:
                continue
            count, down, right = 0, 0, 0
            for i in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for j in range(max(col - reach, 0), min(col + reach + 1, cols)):
                    if used[i, j]:
                        count, down, right = count + 1, down + i, right + j
            middle[row, col, 0], middle[row, col, 1] = down / count, right / count
    mean = np.empty((3, 3))
    for number in range(len(numbers)):
        row, col = numbers[number] // cols, numbers[number] % cols
        inward, aside = middle[row, col, 0] - row, middle[row, col, 1] - col
        count, farther = 0, 0.0
        mean[:] = 0.0
        for i in range(max(row - reach, 0), min(row + reach + 1, rows)):
            for j in range(max(col - reach, 0), min(col + reach + 1, cols)):
                if used[i, j]:
                    count += 1
                    farther += (middle[i, j, 0] - middle[row, col, 0]) * inward
                    farther += (middle[i, j, 1] - middle[row, col, 1]) * aside
                    for a in range(3):
                        for b in range(3):
                            mean[a, b] += told[i, j, a, b]
        squared = inward**2 + aside**2
        # Where the windows about it lie no farther in, nothing is followed.
        factor = min(squared * count / farther, FARTHEST) if farther > 0 else 0.0
        own_squared, change_squared = 0.0, 0.0
        for a in range(3):
            for b in range(3):
                mean[a, b] = factor * (told[row, col, a, b] - mean[a, b] / count)
                own_squared += told[row, col, a, b] ** 2
                change_squared += mean[a, b] ** 2
        if change_squared > LARGEST_SQUARE * own_squared:
            continue
        change[number] = mean


@compiled
def _write_products(
    point: np.ndarray, normal: np.ndarray, used: np.ndarray, mean_point: np.ndarray, products: np.ndarray
) -> None:
    """Write what a row of pixels adds to the sums of the windows that hold them."""
    own = np.empty(6)
    for col in range(len(used)):
        if used[col]:
            for k in range(3):
                own[k] = point[col, k] - mean_point[k]
                own[3 + k] = normal[col, k]
            products[0, col] = 1.0
            for k in range(6):
                products[1 + k, col] = own[k]
                for j in range(3):
                    products[7 + 3 * k + j, col] = own[k] * own[j]


@compiled
def _write_tangents(x: float, y: float, z: float, tangents: np.ndarray) -> None:
    """Write two unit vectors at right angles to this one and to each other (Duff and others, JCGT 2017)."""
    length = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    tangents[0, 0], tangents[0, 1], tangents[0, 2] = 1.0 + sign * x * x * a, sign * b, -sign * x
    tangents[1, 0], tangents[1, 1], tangents[1, 2] = b, sign + y * y * a, -y


@compiled
def _write_bend(
    spread: np.ndarray, shared: np.ndarray, tangents: np.ndarray, count: float, least: float, bend: np.ndarray
) -> float:
    """Write the symmetric part of the change of normals over places within the tangents, and return the places' spread."""
    one, other = tangents[0], tangents[1]
    xx, xy, yy = _form(one, spread, one), _form(one, spread, other), _form(other, spread, other)
    size = (xx + yy) / count
    scale = count * (max(size, least) + TINY)
    xx, xy, yy = xx / scale + LINE, xy / scale, yy / scale + LINE
    determinant = scale * (xx * yy - xy * xy)
    turned_x, turned_xy = _form(one, shared, one), _form(one, shared, other)
    turned_yx, turned_y = _form(other, shared, one), _form(other, shared, other)
    along = (turned_x * yy - turned_xy * xy) / determinant
    across = (turned_y * xx - turned_yx * xy) / determinant
    mixed = 0.5 * (turned_xy * xx - turned_x * xy + turned_yx * yy - turned_y * xy) / determinant
    for a in range(3):
        for b in range(3):
            bend[a, b] = (
                along * one[a] * one[b] + across * other[a] * other[b] + mixed * (one[a] * other[b] + other[a] * one[b])
            )
    return size


@compiled
def _form(left: np.ndarray, matrix: np.ndarray, right: np.ndarray) -> float:
    total = 0.0
    for a in range(3):
        total += left[a] * (matrix[a, 0] * right[0] + matrix[a, 1] * right[1] + matrix[a, 2] * right[2])
    return total
