"""Quadratic surfaces through the points about some pixels: what neighbours say of a pixel that has no point of its own."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from recon.compiled import compiled
from recon.maps import Maps

TERMS = 6
# A polynomial with few points more than terms knows nothing of its own misfit.
FEWEST_POINTS = 2 * TERMS
RIDGE = 1e-9
TINY = float(np.finfo(float).tiny)

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
    where the window's own pixels are far. Points and normals are 0 where too few pixels are known.
    """
    point, normal, centre = (np.zeros((len(row), 3)) for _ in range(3))
    variances = np.full((3, len(row)), np.inf)
    unknown = np.zeros(known.shape, np.float32)
    across_sd = unknown if maps.across_sd_mm is None else maps.across_sd_mm
    normal_sd = unknown if maps.normal_sd_rad is None else maps.normal_sd_rad
    _write_guesses(
        half_width,
        *(maps.point_mm, maps.normal, maps.sd_mm, across_sd, normal_sd),
        *(known, row, col, centre_row, centre_col),
        *(point, normal, centre, variances),
    )
    return Guess(point, normal, centre, *variances)


@compiled
def _write_guesses(
    half_width: int,
    points: np.ndarray,
    normals: np.ndarray,
    sd: np.ndarray,
    across_sd: np.ndarray,
    normal_sd: np.ndarray,
    known: np.ndarray,
    rows: np.ndarray,
    cols: np.ndarray,
    centre_rows: np.ndarray,
    centre_cols: np.ndarray,
    point: np.ndarray,
    normal: np.ndarray,
    centre: np.ndarray,
    variances: np.ndarray,
) -> None:
    """Write what each place's window says: the solution of its normal equations, and the squares of what that leaves."""
    matrix, right, solved = np.empty((TERMS, TERMS)), np.empty((TERMS, 6)), np.empty((TERMS, 7))
    terms, left, squares = np.empty(TERMS), np.empty(6), np.empty(3)
    for place in range(len(rows)):
        row, col, centre_row, centre_col = rows[place], cols[place], centre_rows[place], centre_cols[place]
        top, bottom = max(centre_row - half_width, 0), min(centre_row + half_width + 1, known.shape[0])
        first, last = max(centre_col - half_width, 0), min(centre_col + half_width + 1, known.shape[1])
        count = 0
        for i in range(top, bottom):
            for j in range(first, last):
                count += known[i, j]
        if count < FEWEST_POINTS:
            continue
        matrix[:], right[:] = 0.0, 0.0
        for i in range(top, bottom):
            for j in range(first, last):
                if known[i, j]:
                    _write_terms((j - col) / half_width, (i - row) / half_width, terms)
                    for t in range(TERMS):
                        for s in range(t + 1):
                            matrix[t, s] += terms[t] * terms[s]
                        for k in range(3):
                            right[t, k] += terms[t] * points[i, j, k]
                            right[t, 3 + k] += terms[t] * normals[i, j, k]
        # Places on one line determine nothing; what is added then shows as a variance without bound.
        for t in range(TERMS):
            matrix[t, t] += RIDGE * count
        _solve(matrix, right, solved)
        length = 0.0
        for k in range(3):
            point[place, k], normal[place, k] = solved[0, k], solved[0, 3 + k]
            length += normal[place, k] ** 2
        length = max(np.sqrt(length), TINY)
        for k in range(3):
            normal[place, k] /= length
        squares[:] = 0.0
        shares = variances[:, place]
        shares[:] = 0.0
        for i in range(top, bottom):
            for j in range(first, last):
                if known[i, j]:
                    _write_terms((j - col) / half_width, (i - row) / half_width, terms)
                    across = 0.0
                    for k in range(6):
                        left[k] = points[i, j, k] if k < 3 else normals[i, j, k - 3]
                        for t in range(TERMS):
                            left[k] -= terms[t] * solved[t, k]
                    for k in range(3):
                        squares[0] += left[k] ** 2
                        squares[2] += left[3 + k] ** 2
                        across += left[k] * normal[place, k]
                    squares[1] += across**2
                    shares[0] += np.float64(sd[i, j]) ** 2
                    shares[1] += np.float64(across_sd[i, j]) ** 2
                    shares[2] += np.float64(normal_sd[i, j]) ** 2
        # The place asked for is the origin, where the basis is 1 and five times 0.
        for k in range(3):
            shares[k] = (1.0 + solved[0, 6]) * (shares[k] / count + squares[k] / max(count - TERMS, 1))
        _write_terms((centre_col - col) / half_width, (centre_row - row) / half_width, terms)
        for t in range(TERMS):
            for k in range(3):
                centre[place, k] += terms[t] * solved[t, k]


@compiled
def _write_terms(p: float, q: float, terms: np.ndarray) -> None:
    """Write the terms of a quadratic polynomial at a place."""
    terms[0], terms[1], terms[2], terms[3], terms[4], terms[5] = 1.0, p, q, p * p, p * q, q * q


@compiled
def _solve(matrix: np.ndarray, right: np.ndarray, solved: np.ndarray) -> None:
    """Write the solutions for six right sides, and the first column of the inverse, by Cholesky's factors, made in place."""
    for t in range(TERMS):
        for s in range(t + 1):
            total = matrix[t, s]
            for r in range(s):
                total -= matrix[t, r] * matrix[s, r]
            # What a ridge holds up may be lost in rounding.
            matrix[t, s] = np.sqrt(max(total, TINY)) if s == t else total / matrix[s, s]
    for k in range(7):
        for t in range(TERMS):
            total = right[t, k] if k < 6 else np.float64(t == 0)
            for r in range(t):
                total -= matrix[t, r] * solved[r, k]
            solved[t, k] = total / matrix[t, t]
        for t in range(TERMS - 1, -1, -1):
            total = solved[t, k]
            for r in range(t + 1, TERMS):
                total -= matrix[r, t] * solved[r, k]
            solved[t, k] = total / matrix[t, t]
