"""Quadratic polynomials by weighted least squares over a square window about every pixel, all pixels of a tile at once."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from recon.surface.window_moments import (
    BORDER_PX,
    LARGEST,
    MARGIN_PX,
    PAIRS,
    TERMS,
    fit_windows_of,
    layers_of,
    read_draws,
    sum_windows,
    write_moments,
)

Map = Float64[np.ndarray, "rows cols"]
Fields = Float64[np.ndarray, "fields rows cols"]
# The half-width of nine pixels, three times three.
NINE = 4
# Row, moment and column, within a border.
Layers = Float64[np.ndarray, "padded_rows layers padded_cols"]


@dataclass(frozen=True, slots=True, eq=False)
class WindowFit:
    """The polynomials of a tile, and what draws of the error do to them.

    ``coefficients`` of 1, p, q, p², pq, q² at every pixel; ``factor`` is the lower Cholesky factor L of the normal matrix, row by
    row; ``misfit`` the weighted sum of squared residuals; ``count`` the places used. ``drawn`` holds L⁻¹ times the right side of
    each draw, from which any linear function of its polynomial follows without solving for it; ``drawn_misfit`` its own misfit.
    """

    coefficients: Float64[np.ndarray, "terms rows cols"]
    factor: Float64[np.ndarray, "rows pairs cols"]
    misfit: Map
    count: Map
    drawn: Float64[np.ndarray, "rows terms draws cols"]
    drawn_misfit: Fields

    def value(self, p: Map, q: Map) -> Map:
        """Return the polynomials at one place a pixel."""
        c = self.coefficients
        return c[0] + p * (c[1] + c[3] * p + c[4] * q) + q * (c[2] + c[5] * q)

    def slopes(self, p: Map, q: Map) -> tuple[Map, Map]:
        """Return the derivatives along p and q at one place a pixel."""
        c = self.coefficients
        return c[1] + 2 * c[3] * p + c[4] * q, c[2] + c[4] * p + 2 * c[5] * q

    def value_variance(self, p: Map, q: Map) -> Map:
        """Return the variance of the value at one place a pixel, where the weights are one over independent variances."""
        return self._drawn(basis(p, q))[1]

    def drawn_values(self, p: Map, q: Map) -> Fields:
        """Return the value of each draw's polynomial at one place a pixel."""
        return self._drawn(basis(p, q))[0]

    def drawn_slopes(self, p: Map, q: Map) -> tuple[Fields, Fields, Map]:
        """Return the derivatives of each draw's polynomial along p and q, and the summed variances of both for weights of one."""
        (along_p, variance_p), (along_q, variance_q) = (self._drawn(right) for right in slope_basis(p, q))
        return along_p, along_q, np.minimum(variance_p + variance_q, LARGEST)

    def _drawn(self, right: Float64[np.ndarray, "terms rows cols"]) -> tuple[Fields, Map]:
        """Return this sum of the coefficients for each draw, and its variance for weights of one over variances."""
        values = np.empty((len(self.drawn_misfit), *self.misfit.shape))
        variance = np.empty(self.misfit.shape)
        read_draws(self.factor, self.drawn, right, values, variance)
        return values, variance


def basis(p: Map, q: Map) -> Float64[np.ndarray, "terms rows cols"]:
    """Return 1, p, q, p², pq, q²."""
    return np.stack([np.ones_like(p), p, q, p * p, p * q, q * q])


def slope_basis(
    p: Map, q: Map
) -> tuple[Float64[np.ndarray, "terms rows cols"], Float64[np.ndarray, "terms rows cols"]]:
    """Return the derivatives of 1, p, q, p², pq, q² along p and along q."""
    zero, one = np.zeros_like(p), np.ones_like(p)
    return np.stack((zero, one, zero, 2 * p, q, zero)), np.stack((zero, zero, one, zero, p, 2 * q))


def fit_windows(
    p: Map, q: Map, height: Map, draws: Fields, weight: Map, *, half_widths: tuple[int, ...]
) -> Iterator[WindowFit]:
    """Fit a polynomial over the (2 half_width + 1)² pixels about every pixel, and prepare those of the draws.

    The fits come one half-width after the other, since they share their sums.

    Parameters
    ----------
    p, q
        The places at which the heights were measured, near zero and of order one over a window (a tile's own coordinates).
    height, draws
        What to fit, and draws of its error.
    weight
        How much a pixel counts; 0 leaves it out.
    half_widths
        No larger than ``MARGIN_PX``.

    Raises
    ------
    ValueError
        For a larger half-width, whose sums would reach beyond the margin.
    """
    if max(half_widths) > MARGIN_PX:
        raise ValueError(f"windows may reach {MARGIN_PX} pixels, not {max(half_widths)}")
    rows, cols = p.shape
    p, q, weight = (np.ascontiguousarray(each) for each in (p, q, weight))
    fields = np.concatenate([height[None], draws])
    layers = np.zeros((rows + 2 * BORDER_PX, layers_of(len(fields)), cols + 2 * MARGIN_PX))
    write_moments(p, q, fields, weight, layers)
    threes = layers
    if NINE in half_widths:
        threes = np.empty_like(layers)
        sum_windows(layers, np.arange(-1, 2), threes)
    for half_width in half_widths:
        if half_width == NINE:
            yield _fitted(threes, np.array([-3, 0, 3]), draws=len(draws))
        else:
            yield _fitted(layers, np.arange(-half_width, half_width + 1), draws=len(draws))


def _fitted(layers: Layers, offsets: Int64[np.ndarray, " offsets"], *, draws: int) -> WindowFit:
    """Fit over the windows that hold the pixels at these offsets along rows and columns."""
    rows, cols = layers.shape[0] - 2 * BORDER_PX, layers.shape[2] - 2 * MARGIN_PX
    fit = WindowFit(
        coefficients=np.empty((TERMS, rows, cols)),
        factor=np.empty((rows, PAIRS, cols)),
        misfit=np.empty((rows, cols)),
        count=np.empty((rows, cols)),
        drawn=np.empty((rows, TERMS, draws, cols)),
        drawn_misfit=np.empty((draws, rows, cols)),
    )
    fit_windows_of(layers, offsets, fit.coefficients, fit.factor, fit.misfit, fit.count, fit.drawn, fit.drawn_misfit)
    for misfit in (fit.misfit, fit.drawn_misfit):
        np.maximum(misfit, 0.0, out=misfit)
    return fit
