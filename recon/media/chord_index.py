"""The liquid's index from the object itself: normals stand at right angles on the surface through the entry points.

The entry points do not depend on the index, the normals n ∝ n_liquid U − n_air V do. In a small square of pixels the points
are a smooth function of row and column, whose slopes are two tangents T; n·T = 0 gives the index.
"""

import numpy as np
from jaxtyping import Float64

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


def index_from_chords(point_mm: VectorMap, liquid: VectorMap, air: VectorMap, *, n_air: float) -> IndexEstimate | None:
    """Return the index that makes the normals stand upright on the surface; None where too little of it is seen.

    Parameters
    ----------
    point_mm : entry points on the camera's grid, NaN where there is none.
    liquid, air : unit directions of the two paths.
    n_air : index of air.

    Notes
    -----
    With A = U·T and D = U·T − n_air V·T, (n_liquid − 1) A + D = 0. A tangent's noise runs along the paths, so that it is in
    A alone: D is regressed upon, and A/D = −1/(n_liquid − 1) is unbiased, whatever the noise.
    """
    points, u, v = (_blocks(field) for field in (point_mm, liquid, air))
    known = np.isfinite(points).all(axis=2) & np.isfinite(u).all(axis=2) & np.isfinite(v).all(axis=2)
    enough = known.mean(axis=1) >= LEAST_SHARE
    if np.count_nonzero(enough) < FEWEST_BLOCKS:
        return None
    known = known[enough].astype(np.float64)
    fields = np.nan_to_num(np.concatenate([points, u, v], axis=2)[enough])
    basis = _cubic_basis()
    normal = np.einsum("bk,kt,ks->bts", known, basis, basis, optimize=True)
    right = np.einsum("bk,kt,bkf->btf", known, basis, fields, optimize=True)
    fit = np.linalg.solve(normal, right)
    scatter = _scatter(fields[..., :3], known, basis @ fit[..., :3])
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
    return IndexEstimate(1 - 1 / ratio, float(np.sqrt(variance)) / ratio**2, int(known.sum()))


def _middle_ratio(dependent: np.ndarray, regressor: np.ndarray, certainty: np.ndarray) -> float:
    """Return the median of A/D over the tangents; the steep ones count no more than most, since they may be another path's."""
    told = np.abs(regressor) * np.sqrt(certainty)
    weight = np.minimum(told, np.median(told))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(regressor != 0, dependent / regressor, 0.0)
    order = np.argsort(ratio)
    share = np.cumsum(weight[order])
    return float(ratio[order[np.searchsorted(share, 0.5 * share[-1])]])


def _blocks(field: VectorMap) -> Float64[np.ndarray, "blocks pixels 3"]:
    """Cut a map into squares, leaving out what is left at its end."""
    rows, cols = (size // BLOCK_PX for size in field.shape[:2])
    cut = field[: rows * BLOCK_PX, : cols * BLOCK_PX].reshape(rows, BLOCK_PX, cols, BLOCK_PX, 3)
    return cut.transpose(0, 2, 1, 3, 4).reshape(rows * cols, BLOCK_PX**2, 3)


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


def _scatter(points: np.ndarray, known: np.ndarray, fitted: np.ndarray) -> Float64[np.ndarray, " blocks"]:
    """Return the variance of each block's points about its smooth surface.

    No block counts without limit for being smoother than rounding.
    """
    freedom = np.maximum(known.sum(axis=1) - len(POWERS), 1)
    scatter = (known[..., None] * (points - fitted) ** 2).sum(axis=(1, 2)) / freedom
    return scatter + 1e-6 * np.median(scatter) + np.finfo(np.float64).tiny
