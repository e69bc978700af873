"""Try many places at once: chi-square of every pixel's curve over a grid of places, by matrix products.

A fit that walks downhill may stop at the wrong device pixel of a stepped curve, and where the curve fixes the place only
to an interval (a stripe seen in one photo alone, a footprint inside one device pixel) the curvature at the best place
means nothing. The grid sees both: its best place is where the walk starts, and the spread of the likelihood over it is the
standard deviation of such a place.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64

from recon.sweeps.curve_samples import CurveSamples
from recon.sweeps.curve_table import SHAPES, CurveTable

# The stripe that looks brightest is rarely farther than this from the place, in steps.
SCAN_STEPS = 2
COARSE_PLACES_A_STEP = 8
SCAN_SHAPE = SHAPES.index((0.5, 0.5))
# An interval is scanned this finely, and this far to both sides of its best place, in device pixels or steps (the smaller).
FINE_PLACES_A_PX = 32
FINE_REACH_PX = 1.25
# Nodes and weights for the mean over a standard normal variable.
HERMITE = ((-np.sqrt(3.0), 1 / 6), (0.0, 2 / 3), (np.sqrt(3.0), 1 / 6))
MIDDLE = 1


@dataclass(frozen=True, slots=True, eq=False)
class PlaceSpread:
    """Mean and standard deviation of the place under its likelihood, and the likeliest place, in device pixels."""

    mean_px: Float64[np.ndarray, " pixels"]
    sd_px: Float64[np.ndarray, " pixels"]
    best_px: Float64[np.ndarray, " pixels"]


def best_places(
    samples: CurveSamples,
    weight: Float32[np.ndarray, "pixels samples"],
    *,
    black_weight: float,
    log_width: Float64[np.ndarray, " pixels"],
    table: CurveTable,
) -> Float64[np.ndarray, " pixels"]:
    """Return the place of least chi-square within two steps of the brightest sample, refined by a parabola.

    One shape of footprint does for all: the walk that starts there knows each pixel's own.
    """
    table.fill(np.array([SCAN_SHAPE]))
    step = table.pattern.step_px
    reach = SCAN_STEPS * COARSE_PLACES_A_STEP
    grid = step * np.arange(-reach, reach + 1) / COARSE_PLACES_A_STEP
    node = table.nearest_node(log_width)
    place = np.empty(len(samples.peak))
    for rows in _alike(samples, node, table):
        number = int(node[rows[0]])
        chi_square = _chi_square(samples.some(rows), weight[rows], grid, number, SCAN_SHAPE, table, black_weight)
        best = np.clip(chi_square.argmin(axis=1), 1, len(grid) - 2)
        line = np.arange(len(rows))
        before, least, after = (chi_square[line, best + k].astype(np.float64) for k in (-1, 0, 1))
        curvature = before - 2 * least + after
        shift = np.where(curvature > 0, 0.5 * (before - after) / np.maximum(curvature, 1e-12), 0.0)
        place[rows] = grid[best] + np.clip(shift, -1, 1) * (grid[1] - grid[0])
    return samples.peak_px + place


def place_spread(
    samples: CurveSamples,
    weight: Float32[np.ndarray, "pixels samples"],
    *,
    black_weight: float,
    log_width: Float64[np.ndarray, " pixels"],
    width_sd: Float64[np.ndarray, " pixels"],
    shape: Int64[np.ndarray, " pixels"],
    table: CurveTable,
    about_px: Float64[np.ndarray, " pixels"],
) -> PlaceSpread:
    """Return mean and spread of the likelihood over a fine grid about a place.

    Amplitude and background are at their best; the width is averaged over what is known of it (``log_width`` ± ``width_sd``),
    by Gauss and Hermite's rule of three points.
    """
    unit = min(table.pattern.step_px, 1.0)
    count = round(FINE_REACH_PX * FINE_PLACES_A_PX)
    fine = unit * np.arange(-count, count + 1) / FINE_PLACES_A_PX
    # Pixels whose best places are alike share one grid.
    middle = unit * np.rint((about_px - samples.peak_px) / unit)
    cell = np.rint(middle / unit).astype(np.int64)
    chi_square = np.empty((len(HERMITE), len(middle), len(fine)), dtype=np.float32)
    for number, (shift, _) in enumerate(HERMITE):
        node = table.nearest_node(log_width + shift * width_sd)
        for rows in _alike(samples, node * len(SHAPES) + shape, table, also=cell):
            grid = middle[rows[0]] + fine
            chi_square[number, rows] = _chi_square(
                samples.some(rows), weight[rows], grid, int(node[rows[0]]), int(shape[rows[0]]), table, black_weight
            )
    likeliest = fine[chi_square[MIDDLE].argmin(axis=1)]
    chi_square -= chi_square.min(axis=(0, 2))[:, None]
    likelihood = sum(share * np.exp(-0.5 * one) for (_, share), one in zip(HERMITE, chi_square, strict=True))
    likelihood /= likelihood.sum(axis=1, keepdims=True)
    offset = fine.astype(np.float32)
    first = likelihood @ offset
    variance = likelihood @ offset**2 - first**2
    sd_px = np.sqrt(np.maximum(variance, 0.0), dtype=np.float64)
    return PlaceSpread(samples.peak_px + middle + first, sd_px, samples.peak_px + middle + likeliest)


def _alike(
    samples: CurveSamples, node: np.ndarray, table: CurveTable, *, also: np.ndarray | None = None
) -> list[Int64[np.ndarray, " rows"]]:
    """Return the rows of each group of pixels that one set of templates serves."""
    kinds = int(table.alignment_of.max()) + 1
    key = node * kinds + table.alignment_of[samples.peak + table.pad]
    if also is not None:
        key = key * (also.max() - also.min() + 1) + also - also.min()
    order = np.argsort(key, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(key[order])) + 1) if len(order) else []


def _chi_square(
    samples: CurveSamples,
    weight: np.ndarray,
    grid_px: np.ndarray,
    node: int,
    shape: int,
    table: CurveTable,
    black_weight: float,
) -> Float32[np.ndarray, "pixels places"]:
    """Return chi-square at these places from the brightest sample, less a constant of each pixel."""
    offset = np.arange(-samples.half_width, samples.half_width + 1)
    kind = table.alignment_of[samples.peak[0] + offset + table.pad]
    curve = table.value[shape, node][kind, table.entry(grid_px[:, None] - table.pattern.step_px * offset)]
    weighted = weight * samples.height
    s_mm = weight @ (curve**2).T + np.float32(1e-12)
    s_m = weight @ curve.T
    s_my = weighted @ curve.T
    s_1 = weight.sum(axis=1, keepdims=True) + np.float32(black_weight)
    s_y = weighted.sum(axis=1, keepdims=True)
    # Background removed first: what the curve then explains is the drop of chi-square.
    inner = s_mm - s_m**2 / s_1
    toward = s_my - s_m * s_y / s_1
    # A stripe takes no light away.
    return -(np.maximum(toward, 0.0) ** 2) / np.maximum(inner, 1e-6 * s_mm)
