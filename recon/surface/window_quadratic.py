"""Quadratic polynomials by weighted least squares over a square window about every pixel, all pixels of a tile at once."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

Map = Float64[np.ndarray, "rows cols"]
Fields = Float64[np.ndarray, "fields rows cols"]

TERMS = 6
# Keeps a window without six independent places solvable; its variance then tells that it knows nothing.
RIDGE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class WindowFit:
    """The polynomials of a tile.

    ``coefficients`` of 1, p, q, p², pq, q², one polynomial a field and pixel; ``factor`` is the lower Cholesky factor of the
    normal matrix (nothing above the diagonal); ``misfit`` the weighted sum of squared residuals; ``count`` the places used.
    """

    coefficients: Float64[np.ndarray, "fields terms rows cols"]
    factor: Float64[np.ndarray, "terms terms rows cols"]
    misfit: Fields
    count: Map

    def value(self, p: Map, q: Map) -> Fields:
        """Return the polynomials at one place a pixel."""
        return np.einsum("ftrc,trc->frc", self.coefficients, basis(p, q))

    def slopes(self, p: Map, q: Map) -> tuple[Fields, Fields]:
        """Return the derivatives along p and q at one place a pixel."""
        one, c = np.ones_like(p), self.coefficients
        along_p = c[:, 1] * one + 2 * c[:, 3] * p + c[:, 4] * q
        along_q = c[:, 2] * one + c[:, 4] * p + 2 * c[:, 5] * q
        return along_p, along_q

    def value_variance(self, p: Map, q: Map) -> Map:
        """Return the variance of the value at one place a pixel, where the weights are one over independent variances."""
        return self._variance(basis(p, q))

    def slope_variance(self, p: Map, q: Map) -> Map:
        """Return the summed variances of both slopes at one place a pixel, where the weights are one over variances."""
        zero, one = np.zeros_like(p), np.ones_like(p)
        along_p, along_q = (zero, one, zero, 2 * p, q, zero), (zero, zero, one, zero, p, 2 * q)
        return self._variance(np.stack(along_p)) + self._variance(np.stack(along_q))

    def _variance(self, right: Float64[np.ndarray, "terms rows cols"]) -> Map:
        """Return the variance of this sum of the coefficients."""
        solved: list[np.ndarray] = []
        for row in range(TERMS):
            rest = right[row] - sum(self.factor[row, k] * solved[k] for k in range(row))
            solved.append(rest / self.factor[row, row])
        # A window that knows nothing has pivots near zero; beyond this, a variance is infinite for every purpose.
        return np.minimum(np.sum(np.square(np.clip(solved, -1e100, 1e100)), axis=0), 1e100)


def basis(p: Map, q: Map) -> Float64[np.ndarray, "terms rows cols"]:
    """Return 1, p, q, p², pq, q²."""
    return np.stack([np.ones_like(p), p, q, p * p, p * q, q * q])


def fit_windows(p: Map, q: Map, fields: Fields, weight: Map, *, half_width: int) -> WindowFit:
    """Fit each field over the (2 half_width + 1)² pixels about every pixel.

    Parameters
    ----------
    p, q
        The places at which the fields were measured, near zero and of order one over a window (a tile's own coordinates).
    fields
        What to fit; anything finite where the weight is 0.
    weight
        How much a pixel counts; 0 leaves it out.
    """
    terms = basis(p, q)
    weighted = weight * terms
    rows, columns = np.tril_indices(TERMS)
    moments = _window_sums(np.concatenate([weighted[rows] * terms[columns], (weight > 0)[None]]), half_width)
    matrix = np.zeros((TERMS, TERMS, *p.shape))
    matrix[rows, columns] = moments[:-1]
    factor = _cholesky(matrix)
    right = _window_sums((weighted[None] * fields[:, None]).reshape(-1, *p.shape), half_width)
    right = right.reshape(len(fields), TERMS, *p.shape)
    coefficients = _solve(factor, right)
    squares = _window_sums(weight * fields**2, half_width)
    misfit = np.maximum(squares - (coefficients * right).sum(axis=1), 0.0)
    return WindowFit(coefficients, factor, misfit, moments[-1])


def _window_sums(fields: Fields, half_width: int) -> Fields:
    """Sum over the window, term by term: a running sum would leave the rounding of large weights on small ones."""
    ones = np.ones(2 * half_width + 1)
    stacked = np.ascontiguousarray(np.moveaxis(fields, 0, -1))
    summed = cv2.sepFilter2D(stacked, cv2.CV_64F, ones, ones, borderType=cv2.BORDER_CONSTANT)
    return np.moveaxis(summed.reshape(stacked.shape), -1, 0)


def _cholesky(matrix: np.ndarray) -> np.ndarray:
    """Factorise the symmetric matrices [6, 6, rows, cols], of which only the lower half is read."""
    factor = np.zeros_like(matrix)
    ridge = RIDGE * sum(matrix[k, k] for k in range(TERMS)) + np.finfo(float).tiny
    for column in range(TERMS):
        pivot = matrix[column, column] - sum(factor[column, k] ** 2 for k in range(column))
        factor[column, column] = np.sqrt(np.maximum(pivot, ridge))
        for row in range(column + 1, TERMS):
            rest = matrix[row, column] - sum(factor[row, k] * factor[column, k] for k in range(column))
            factor[row, column] = rest / factor[column, column]
    return factor


def _solve(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve for every field by forward and backward substitution."""
    result = right.copy()
    for row in range(TERMS):
        for k in range(row):
            result[:, row] -= factor[row, k] * result[:, k]
        result[:, row] /= factor[row, row]
    for row in reversed(range(TERMS)):
        for k in range(row + 1, TERMS):
            result[:, row] -= factor[k, row] * result[:, k]
        result[:, row] /= factor[row, row]
    return result
