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
# Beyond this, a number is infinite for every purpose.
LARGEST = 1e100


@dataclass(frozen=True, slots=True, eq=False)
class WindowFit:
    """The polynomials of a tile, and what draws of the error do to them.

    ``coefficients`` of 1, p, q, p², pq, q² at every pixel; ``factor`` is the lower Cholesky factor L of the normal matrix, with
    nothing above the diagonal; ``misfit`` the weighted sum of squared residuals; ``count`` the places used. ``drawn`` holds L⁻¹
    times the right side of each draw, from which any linear function of its polynomial follows without solving for it;
    ``drawn_misfit`` its sum of squared residuals.
    """

    coefficients: Float64[np.ndarray, "terms rows cols"]
    factor: Float64[np.ndarray, "terms terms rows cols"]
    misfit: Map
    count: Map
    drawn: Float64[np.ndarray, "draws terms rows cols"]
    drawn_misfit: Fields

    def value(self, p: Map, q: Map) -> Map:
        """Return the polynomials at one place a pixel."""
        return np.einsum("trc,trc->rc", self.coefficients, basis(p, q))

    def slopes(self, p: Map, q: Map) -> tuple[Map, Map]:
        """Return the derivatives along p and q at one place a pixel."""
        c = self.coefficients
        return c[1] + 2 * c[3] * p + c[4] * q, c[2] + c[4] * p + 2 * c[5] * q

    def value_variance(self, p: Map, q: Map) -> Map:
        """Return the variance of the value at one place a pixel, where the weights are one over independent variances."""
        return _squares(self._lowered(basis(p, q)))

    def drawn_values(self, p: Map, q: Map) -> Fields:
        """Return the value of each draw's polynomial at one place a pixel."""
        return np.einsum("trc,dtrc->drc", self._lowered(basis(p, q)), self.drawn)

    def drawn_slopes(self, p: Map, q: Map) -> tuple[Fields, Fields, Map]:
        """Return the derivatives of each draw's polynomial along p and q, and the summed variances of both for weights of one."""
        along_p, along_q = (self._lowered(right) for right in slope_basis(p, q))
        variance = np.minimum(_squares(along_p) + _squares(along_q), LARGEST)
        return (
            np.einsum("trc,dtrc->drc", along_p, self.drawn),
            np.einsum("trc,dtrc->drc", along_q, self.drawn),
            variance,
        )

    def _lowered(self, right: Float64[np.ndarray, "terms rows cols"]) -> Float64[np.ndarray, "terms rows cols"]:
        """Return L⁻¹ times this sum of the coefficients."""
        return _forward(self.factor, right[None])[0]


def _squares(values: Float64[np.ndarray, "terms rows cols"]) -> Map:
    """Return the sum of squares; a window that knows nothing has pivots near zero, and a variance as good as infinite."""
    return np.minimum(np.square(np.clip(values, -LARGEST, LARGEST)).sum(axis=0), LARGEST)


def basis(p: Map, q: Map) -> Float64[np.ndarray, "terms rows cols"]:
    """Return 1, p, q, p², pq, q²."""
    return np.stack([np.ones_like(p), p, q, p * p, p * q, q * q])


def slope_basis(
    p: Map, q: Map
) -> tuple[Float64[np.ndarray, "terms rows cols"], Float64[np.ndarray, "terms rows cols"]]:
    """Return the derivatives of 1, p, q, p², pq, q² along p and along q."""
    zero, one = np.zeros_like(p), np.ones_like(p)
    return np.stack((zero, one, zero, 2 * p, q, zero)), np.stack((zero, zero, one, zero, p, 2 * q))


def fit_windows(p: Map, q: Map, height: Map, draws: Fields, weight: Map, *, half_width: int) -> WindowFit:
    """Fit a polynomial over the (2 half_width + 1)² pixels about every pixel, and prepare those of the draws.

    Parameters
    ----------
    p, q
        The places at which the heights were measured, near zero and of order one over a window (a tile's own coordinates).
    height, draws
        What to fit, and draws of its error; anything finite where the weight is 0.
    weight
        How much a pixel counts; 0 leaves it out.
    """
    terms = basis(p, q)
    weighted = weight * terms
    rows, columns = np.tril_indices(TERMS)
    fields = np.concatenate([height[None], draws])
    known = len(rows) + 1
    layers = np.empty((known + (TERMS + 1) * len(fields), *p.shape))
    np.multiply(weighted[rows], terms[columns], out=layers[: known - 1])
    layers[known - 1] = weight > 0
    right = layers[known : known + TERMS * len(fields)].reshape(len(fields), TERMS, *p.shape)
    np.multiply(weighted[None], fields[:, None], out=right)
    np.multiply(weight * fields, fields, out=layers[known + TERMS * len(fields) :])
    sums = _window_sums(layers, half_width)
    matrix = np.zeros((TERMS, TERMS, *p.shape))
    matrix[rows, columns] = sums[: known - 1]
    factor = _cholesky(matrix)
    right = sums[known : known + TERMS * len(fields)].reshape(len(fields), TERMS, *p.shape)
    lowered = _forward(factor, right)
    misfit = sums[known + TERMS * len(fields) :] - np.einsum("dtrc,dtrc->drc", lowered, lowered)
    misfit = np.maximum(misfit, 0.0, out=misfit)
    return WindowFit(_backward(factor, lowered[0]), factor, misfit[0], sums[known - 1], lowered[1:], misfit[1:])


def _window_sums(fields: Fields, half_width: int) -> Fields:
    """Sum over the window, term by term: a running sum would leave the rounding of large weights on small ones.

    All fields are one tall picture, with as many empty rows between them as a window reaches.
    """
    ones = np.ones(2 * half_width + 1)
    count, rows, cols = fields.shape
    tall = np.zeros((count, rows + half_width, cols))
    tall[:, :rows] = fields
    summed = cv2.sepFilter2D(tall.reshape(-1, cols), cv2.CV_64F, ones, ones, borderType=cv2.BORDER_CONSTANT)
    return np.ascontiguousarray(summed.reshape(tall.shape)[:, :rows])


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


def _forward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return L⁻¹ times every field [fields, terms, rows, cols]."""
    result = right.copy()
    for row in range(TERMS):
        for k in range(row):
            result[:, row] -= factor[row, k] * result[:, k]
        result[:, row] /= factor[row, row]
    return result


def _backward(factor: np.ndarray, lowered: np.ndarray) -> np.ndarray:
    """Return L⁻ᵀ times one field [terms, rows, cols]."""
    result = lowered.copy()
    for row in reversed(range(TERMS)):
        for k in range(row + 1, TERMS):
            result[row] -= factor[k, row] * result[k]
        result[row] /= factor[row, row]
    return result
