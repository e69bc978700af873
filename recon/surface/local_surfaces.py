"""Quadratic surfaces through the points about some pixels: what neighbours say of a pixel that has no point of its own."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from recon.maps import Maps

TERMS = 6
# A polynomial with few points more than terms knows nothing of its own misfit.
FEWEST_POINTS = 2 * TERMS
RIDGE = 1e-9

Mask = Bool[np.ndarray, "rows cols"]
Whole = Int64[np.ndarray, " places"]
PerPlace = Float64[np.ndarray, " places"]


@dataclass(frozen=True, slots=True, eq=False)
class Guess:
    """What a surface says of some pixels: points, unit normals, and their variances, infinite where it says nothing.

    ``centre_mm`` is the surface's point in the middle of its window, ``across_mm2`` the point's variance across the surface.
    """

    point_mm: Float64[np.ndarray, "places 3"]
    normal: Float64[np.ndarray, "places 3"]
    centre_mm: Float64[np.ndarray, "places 3"]
    variance_mm2: PerPlace
    across_mm2: PerPlace
    variance_rad2: PerPlace

    def some(self, places: Bool[np.ndarray, " places"]) -> "Guess":
        """Return what it says of some of the pixels."""
        return Guess(*(getattr(self, name)[places] for name in Guess.__slots__))


def guess_from(
    maps: Maps, known: Mask, row: Whole, col: Whole, centre_row: Whole, centre_col: Whole, *, half_width: int
) -> Guess:
    """Fit the ``known`` pixels in a window about each centre, and read the fit at (row, col).

    Neighbours' errors are alike, so that a mean of many is no surer than one of them: a point's variance is theirs, and what
    their polynomial leaves of them, times 1 plus the variance of the value itself (in units of one pixel's), which grows
    where the window's own pixels are far.
    """
    side = np.arange(-half_width, half_width + 1)
    rows = centre_row[:, None, None] + side[:, None]
    cols = centre_col[:, None, None] + side[None, :]
    rows, cols = (np.broadcast_to(each, (len(row), len(side), len(side))) for each in (rows, cols))
    inside = (rows >= 0) & (rows < known.shape[0]) & (cols >= 0) & (cols < known.shape[1])
    rows, cols = np.where(inside, rows, 0).reshape(len(row), -1), np.where(inside, cols, 0).reshape(len(row), -1)
    used = inside.reshape(len(row), -1) & known[rows, cols]
    count = used.sum(axis=1)
    terms = _basis((cols - col[:, None]) / half_width, (rows - row[:, None]) / half_width) * used[..., None]
    values = np.concatenate([maps.point_mm[rows, cols], maps.normal[rows, cols]], axis=2)
    values = np.where(used[..., None], values, 0.0)
    turned = np.swapaxes(terms, 1, 2)
    matrix = turned @ terms
    determined = count >= FEWEST_POINTS
    # Places on one line determine nothing; what is added then shows as a variance without bound.
    matrix += RIDGE * np.maximum(count, 1)[:, None, None] * np.eye(TERMS)
    inverse = np.linalg.inv(matrix)
    coefficients = inverse @ (turned @ values)
    left = np.where(used[..., None], values - terms @ coefficients, 0.0)
    freedom = np.maximum(count - TERMS, 1)
    # The place asked for is the origin, where the basis is 1 and five times 0.
    spread = 1.0 + inverse[:, 0, 0]
    normal = coefficients[:, 0, 3:]
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    across = (left[..., :3] @ normal[:, :, None])[..., 0]
    variances = [
        np.where(determined, spread * (_mean_square(sd, rows, cols, used) + squares / freedom), np.inf)
        for sd, squares in (
            (maps.sd_mm, (left[..., :3] ** 2).sum(axis=(1, 2))),
            (maps.across_sd_mm, (across**2).sum(axis=1)),
            (maps.normal_sd_rad, (left[..., 3:] ** 2).sum(axis=(1, 2))),
        )
    ]
    middle = _basis((centre_col - col) / half_width, (centre_row - row) / half_width)
    centre_mm = np.einsum("nt,ntf->nf", middle, coefficients[..., :3])
    return Guess(coefficients[:, 0, :3], normal, centre_mm, *variances)


def _mean_square(sd: np.ndarray | None, rows: np.ndarray, cols: np.ndarray, used: np.ndarray) -> PerPlace:
    if sd is None:
        return np.zeros(len(rows))
    squared = np.where(used, sd[rows, cols].astype(np.float64) ** 2, 0.0)
    return squared.sum(axis=1) / np.maximum(used.sum(axis=1), 1)


def _basis(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(p), p, q, p * p, p * q, q * q], axis=-1)
