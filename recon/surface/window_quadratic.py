"""Quadratic polynomials by weighted least squares over a square window about every pixel, all pixels of a tile at once."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from recon.surface.window_moments import (
    ALONG,
    COLUMNS,
    COUNTED,
    DRAWN_MISFIT,
    FOUND,
    MARGIN_PX,
    MISFIT,
    SLOPE_P,
    SLOPE_Q,
    TERMS,
    fit_along_lines,
)

Map = Float64[np.ndarray, "rows cols"]


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """A line for every pixel, from a place (p, q, height) along a sight that all share."""

    start: Float64[np.ndarray, "rows cols 3"]
    sight: Float64[np.ndarray, " 3"]

    @classmethod
    def upright(cls, p: Map, q: Map) -> "Lines":
        """Return those along the height over the places p, q, from a height of 0."""
        return cls(np.stack([p, q, np.zeros_like(p)], axis=-1), np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, slots=True, eq=False)
class WindowFit:
    """The polynomials of a tile where each pixel's line meets its own, and what draws of the heights' error do to them.

    ``coefficients`` of 1, p, q, p², pq, q² at every pixel; ``along`` is how far along its line it is met, ``slope_p`` and
    ``slope_q`` its derivatives there. ``misfit`` is the weighted sum of squared residuals, ``drawn_misfit`` the mean of that of
    the draws; ``count`` the places used. ``drawn`` are the readings of each draw's polynomial at that place: its value and, if
    asked for, its derivatives along p and q; ``variance`` is that of each reading, where the weights are one over variances.
    """

    coefficients: Float64[np.ndarray, "terms rows cols"]
    along: Map
    slope_p: Map
    slope_q: Map
    misfit: Map
    count: Map
    drawn_misfit: Map
    drawn: Float32[np.ndarray, "readings draws rows cols"]
    variance: Float64[np.ndarray, "readings rows cols"]


def fit_windows(
    p: Map,
    q: Map,
    height: Map,
    draws: Float32[np.ndarray, "draws rows cols"],
    weight: Map,
    lines: Lines,
    *,
    half_widths: tuple[int, ...],
    readings: int,
) -> list[WindowFit]:
    """Fit a polynomial over the (2 half_width + 1)² pixels about every pixel, for one half-width after the other.

    Parameters
    ----------
    p, q
        The places at which the heights were measured, near zero and of order one over a window (a tile's own coordinates).
    height, draws
        What to fit, and draws of its error.
    weight
        How much a pixel counts; 0 leaves it out.
    lines
        Where the polynomials are asked for.
    half_widths
        In growing order, no larger than ``MARGIN_PX``.
    readings
        1 for the draws' values alone, 3 for their slopes too.

    Raises
    ------
    ValueError
        For a larger half-width, whose sums would reach beyond the margin, and for a map wider than ``COLUMNS``.
    """
    if max(half_widths) > MARGIN_PX:
        raise ValueError(f"windows may reach {MARGIN_PX} pixels, not {max(half_widths)}")
    rows, cols = p.shape
    if cols > COLUMNS:
        raise ValueError(f"a map of windows may be {COLUMNS} pixels wide, not {cols}")
    windows = len(half_widths)
    coefficients = np.empty((windows, TERMS, rows, cols))
    found = np.empty((windows, FOUND, rows, cols))
    drawn = np.empty((windows, readings, len(draws), rows, cols), np.float32)
    variance = np.empty((windows, readings, rows, cols))
    p, q, height, draws, weight = (np.ascontiguousarray(each) for each in (p, q, height, draws, weight))
    start, sight = np.ascontiguousarray(lines.start), np.ascontiguousarray(lines.sight)
    widths = np.array(half_widths)
    fit_along_lines(p, q, height, draws, weight, start, sight, widths, coefficients, found, drawn, variance)
    for squares in (found[:, MISFIT], found[:, DRAWN_MISFIT]):
        np.maximum(squares, 0.0, out=squares)
    return [
        WindowFit(
            coefficients=coefficients[window],
            along=found[window, ALONG],
            slope_p=found[window, SLOPE_P],
            slope_q=found[window, SLOPE_Q],
            misfit=found[window, MISFIT],
            count=found[window, COUNTED],
            drawn_misfit=found[window, DRAWN_MISFIT],
            drawn=drawn[window],
            variance=variance[window],
        )
        for window in range(windows)
    ]
