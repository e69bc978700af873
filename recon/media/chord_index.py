"""The liquid's index from the object itself: normals stand at right angles on the surface through the entry points.

The entry points do not depend on the index, the normals n ∝ n_liquid U − n_air V do. In a small square of pixels the points
are a smooth function of row and column, whose slopes are two tangents T; n·T = 0 gives the index.
"""

import numpy as np
from jaxtyping import Float64, Int64

from recon.compiled import compiled
from recon.media.index_estimate import IndexEstimate, robust_weights, variance_by_bands

# Wide enough for the points' noise to average out, narrow enough for a third-order surface.
BLOCK_PX = 11
LEAST_SHARE = 0.9
FEWEST_BLOCKS = 12
ROUNDS = 8
POWERS = tuple((i, j) for i in range(4) for j in range(4 - i))
# Where a least squares fit of third order has the right slope and value even where the surface is of fifth order: about the zeros
# of Legendre's P₅' along the slope, and of P₄ across it.
PLACES = np.array([(row, column) for row in (-0.285, 0.285) for column in (-0.340, 0.340)])

VectorMap = Float64[np.ndarray, "rows cols 3"]


def index_from_chords(
    point_mm: VectorMap,
    variance_mm2: Float64[np.ndarray, "rows cols"],
    liquid: VectorMap,
    air: VectorMap,
    *,
    n_air: float,
) -> IndexEstimate | None:
    """Return the index that makes the normals stand upright on the surface; None where too little of it is seen.

    Parameters
    ----------
    point_mm, variance_mm2 : entry points on the camera's grid, NaN where there is none, and the traces of their covariances.
    liquid, air : unit directions of the two paths.
    n_air : index of air.

    Notes
    -----
    With A = U·T and D = U·T − n_air V·T, (n_liquid − 1) A + D = 0. A tangent's noise runs along the paths, so that it is in
    A alone: D is regressed upon, and A/D = −1/(n_liquid − 1) is unbiased, whatever the noise.
    """
    rows, cols = (size // BLOCK_PX for size in point_mm.shape[:2])
    basis = _cubic_basis()
    maps = (np.ascontiguousarray(point_mm), np.ascontiguousarray(liquid), np.ascontiguousarray(air))
    counts = np.zeros(rows * cols, np.int64)
    normal, right = np.zeros((rows * cols, len(POWERS), len(POWERS))), np.zeros((rows * cols, len(POWERS), 9))
    _write_sums(*maps, basis, cols, counts, normal, right)
    enough = counts >= LEAST_SHARE * BLOCK_PX**2
    if np.count_nonzero(enough) < FEWEST_BLOCKS:
        return None
    counts, normal = counts[enough], normal[enough]
    fit = np.linalg.solve(normal, right[enough])
    # Errors that all points of a block share leave no scatter: it is no surer than these say on the mean.
    stated = _block_means(variance_mm2, rows, cols)[enough]
    scatter = np.maximum(_scatter(maps, basis, np.flatnonzero(enough), counts, fit), stated)
    shape = np.linalg.inv(normal)
    a, d, spread = [], [], []
    for places, along_row in ((PLACES, True), (PLACES[:, ::-1], False)):
        for place in places:
            here, slope = _terms(*place), _slopes(*place, along_row=along_row)
            u, v, tangent = here @ fit[..., 3:6], here @ fit[..., 6:9], slope @ fit[..., :3]
            a.append(np.einsum("bi,bi->b", u, tangent))
            d.append(a[-1] - n_air * np.einsum("bi,bi->b", v, tangent))
            spread.append(scatter * np.einsum("t,bts,s->b", slope, shape, slope))
    dependent, regressor = np.concatenate(a), np.concatenate(d)[:, None]
    certainty = 1 / np.concatenate(spread)
    ratio = _middle_ratio(dependent, regressor[:, 0], certainty)
    for _ in range(ROUNDS):
        residual = dependent - ratio * regressor[:, 0]
        weight = certainty * robust_weights(residual * np.sqrt(certainty))
        ratio = float((weight * regressor[:, 0]) @ dependent / ((weight * regressor[:, 0]) @ regressor[:, 0]))
    residual = dependent - ratio * regressor[:, 0]
    row, column = (
        np.tile(number, 2 * len(PLACES)) for number in np.divmod(np.flatnonzero(enough), point_mm.shape[1] // BLOCK_PX)
    )
    variance = variance_by_bands(regressor, regressor * weight[:, None], residual, row=row, column=column)
    return IndexEstimate(1 - 1 / ratio, float(np.sqrt(variance)) / ratio**2, int(counts.sum()))


def _middle_ratio(dependent: np.ndarray, regressor: np.ndarray, certainty: np.ndarray) -> float:
    """Return the median of A/D over the tangents; the steep ones count no more than most, since they may be another path's."""
    told = np.abs(regressor) * np.sqrt(certainty)
    weight = np.minimum(told, np.median(told))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(regressor != 0, dependent / regressor, 0.0)
    order = np.argsort(ratio)
    share = np.cumsum(weight[order])
    return float(ratio[order[np.searchsorted(share, 0.5 * share[-1])]])


def _block_means(values: Float64[np.ndarray, "rows cols"], rows: int, cols: int) -> Float64[np.ndarray, " blocks"]:
    """Return the means of the values that are known in each block."""
    blocks = values[: rows * BLOCK_PX, : cols * BLOCK_PX].reshape(rows, BLOCK_PX, cols, BLOCK_PX)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    return (np.nansum(blocks, axis=(1, 3)) / np.maximum(known, 1)).ravel()


def _cubic_basis() -> Float64[np.ndarray, "pixels terms"]:
    """Return the terms at every pixel of a block, whose row and column run from −1 to 1."""
    step = np.linspace(-1, 1, BLOCK_PX)
    return np.array([_terms(row, column) for row in step for column in step])


def _terms(row: float, column: float) -> Float64[np.ndarray, " terms"]:
    """Return row^i column^j at one place, up to the third order."""
    return np.array([row**i * column**j for i, j in POWERS])


def _slopes(row: float, column: float, *, along_row: bool) -> Float64[np.ndarray, " terms"]:
    """Return the derivatives of the terms at one place, along the row's or the column's number."""
    if not along_row:
        return np.array([j * row**i * column ** max(j - 1, 0) for i, j in POWERS])
    return np.array([i * row ** max(i - 1, 0) * column**j for i, j in POWERS])


def _scatter(
    maps: tuple[VectorMap, VectorMap, VectorMap],
    basis: Float64[np.ndarray, "pixels terms"],
    blocks: Int64[np.ndarray, " blocks"],
    counts: Int64[np.ndarray, " blocks"],
    fit: Float64[np.ndarray, "blocks terms 9"],
) -> Float64[np.ndarray, " blocks"]:
    """Return the variance of each block's points about its smooth surface.

    No block counts without limit for being smoother than rounding.
    """
    squares = np.empty(len(blocks))
    _write_squares(*maps, basis, maps[0].shape[1] // BLOCK_PX, blocks, fit, squares)
    scatter = squares / np.maximum(counts - len(POWERS), 1)
    return scatter + 1e-6 * np.median(scatter) + np.finfo(np.float64).tiny


@compiled
def _write_sums(
    point: np.ndarray,
    liquid: np.ndarray,
    air: np.ndarray,
    basis: np.ndarray,
    cols: int,
    counts: np.ndarray,
    normal: np.ndarray,
    right: np.ndarray,
) -> None:
    """Write how many pixels of each block are known, and the equations of the polynomials through them."""
    terms = basis.shape[1]
    for block in range(len(counts)):
        top, first = BLOCK_PX * (block // cols), BLOCK_PX * (block % cols)
        for place in range(BLOCK_PX**2):
            row, col = top + place // BLOCK_PX, first + place % BLOCK_PX
            if not _is_known(point[row, col], liquid[row, col], air[row, col]):
                continue
            counts[block] += 1
            for t in range(terms):
                term = basis[place, t]
                for other in range(terms):
                    normal[block, t, other] += term * basis[place, other]
                for k in range(3):
                    right[block, t, k] += term * point[row, col, k]
                    right[block, t, 3 + k] += term * liquid[row, col, k]
                    right[block, t, 6 + k] += term * air[row, col, k]


@compiled
def _is_known(point: np.ndarray, liquid: np.ndarray, air: np.ndarray) -> bool:
    known = True
    for k in range(3):
        known &= np.isfinite(point[k]) and np.isfinite(liquid[k]) and np.isfinite(air[k])
    return known


@compiled
def _write_squares(
    point: np.ndarray,
    liquid: np.ndarray,
    air: np.ndarray,
    basis: np.ndarray,
    cols: int,
    blocks: np.ndarray,
    fit: np.ndarray,
    squares: np.ndarray,
) -> None:
    """Write what the points of some blocks leave of their polynomials, squared."""
    for number in range(len(blocks)):
        top, first = BLOCK_PX * (blocks[number] // cols), BLOCK_PX * (blocks[number] % cols)
        squares[number] = 0.0
        for place in range(BLOCK_PX**2):
            row, col = top + place // BLOCK_PX, first + place % BLOCK_PX
            if not _is_known(point[row, col], liquid[row, col], air[row, col]):
                continue
            for k in range(3):
                left = point[row, col, k]
                for t in range(basis.shape[1]):
                    left -= basis[place, t] * fit[number, t, k]
                squares[number] += left**2
