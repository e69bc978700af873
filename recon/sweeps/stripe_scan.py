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
# Fewer pixels than this with the same templates are not worth a matrix product of their own.
FEWEST_ALIKE = 48
MIXED_AT_ONCE = 512
# OpenBLAS wakes its threads for a matrix product of more multiplications than this. They wait for each other, spinning, while
# the cores are busy with other sweeps.
ALONE_PRODUCTS = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class PlaceSpread:
    """Mean and standard deviation of the place under its likelihood, and the likeliest place, in device pixels."""

    mean_px: Float64[np.ndarray, " pixels"]
    sd_px: Float64[np.ndarray, " pixels"]
    best_px: Float64[np.ndarray, " pixels"]


def best_places(
    samples: CurveSamples,
    weight: Float32[np.ndarray, "samples pixels"],
    *,
    black_weight: float,
    log_width: Float64[np.ndarray, " pixels"],
    table: CurveTable,
) -> Float64[np.ndarray, " pixels"]:
    """Return the place of least chi-square within two steps of the brightest sample, refined by a parabola.

    One shape of footprint does for all: the walk that starts there knows each pixel's own.
    """
    step = table.pattern.step_px
    reach = SCAN_STEPS * COARSE_PLACES_A_STEP
    grid = step * np.arange(-reach, reach + 1) / COARSE_PLACES_A_STEP
    node, shape = table.nearest_node(log_width), np.full(len(log_width), SCAN_SHAPE)
    table.fill(shape, node)
    place = np.empty(len(samples.peak))
    middle = np.zeros(len(node))
    for rows in _alike(samples, node, table):
        explained = _explained(samples, weight, rows, grid, middle, node, shape, table, black_weight)
        best = np.clip(_highest(explained), 1, len(grid) - 2)
        line = np.arange(len(rows))
        before, most, after = (explained[best + k, line].astype(np.float64) for k in (-1, 0, 1))
        curvature = 2 * most - before - after
        shift = np.where(curvature > 0, 0.5 * (after - before) / np.maximum(curvature, 1e-12), 0.0)
        place[rows] = grid[best] + np.clip(shift, -1, 1) * (grid[1] - grid[0])
    return samples.peak_px + place


def place_spread(
    samples: CurveSamples,
    weight: Float32[np.ndarray, "samples pixels"],
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
    powers = np.stack([np.ones_like(fine), fine, fine**2]).astype(np.float32)
    likeliest = np.empty(len(middle))
    top = np.empty((len(HERMITE), len(middle)), dtype=np.float32)
    moments = np.empty((len(HERMITE), len(powers), len(middle)), dtype=np.float32)
    nodes = [table.nearest_node(log_width + shift * width_sd) for shift, _ in HERMITE]
    for number in (MIDDLE, *(other for other in range(len(HERMITE)) if other != MIDDLE)):
        node = nodes[number]
        table.fill(shape, node)
        # A width that is known well has one node, and one scan.
        same = (node == nodes[MIDDLE]) & (number != MIDDLE)
        top[number, same], moments[number][:, same] = top[MIDDLE, same], moments[MIDDLE][:, same]
        for rows in _alike(samples, node * len(SHAPES) + shape, table, also=cell, among=np.flatnonzero(~same)):
            explained = _explained(samples, weight, rows, fine, middle, node, shape, table, black_weight)
            if number == MIDDLE:
                likeliest[rows] = fine[_highest(explained)]
            highest = np.maximum.reduce(explained, axis=0)
            explained -= highest
            explained *= np.float32(0.5)
            moments[number][:, rows] = _summed(np.exp(explained, out=explained), powers)
            top[number, rows] = highest
    share = np.array([share for _, share in HERMITE], dtype=np.float32)[:, None] * np.exp(0.5 * (top - top.max(axis=0)))
    mass, first, second = np.einsum("wp,wmp->mp", share, moments).astype(np.float64)
    first /= mass
    sd_px = np.sqrt(np.maximum(second / mass - first**2, 0.0))
    return PlaceSpread(samples.peak_px + middle + first, sd_px, samples.peak_px + middle + likeliest)


def _alike(
    samples: CurveSamples,
    node: np.ndarray,
    table: CurveTable,
    *,
    also: np.ndarray | None = None,
    among: np.ndarray | None = None,
) -> list[Int64[np.ndarray, " rows"]]:
    """Return the rows of each large group of pixels that one set of templates serves, then all others, some at a time."""
    kinds = int(table.alignment_of.max()) + 1
    key = node * kinds + table.alignment_of[samples.peak + table.pad]
    if also is not None:
        key = key * (also.max() - also.min() + 1) + also - also.min()
    rows = np.arange(len(key)) if among is None else among
    order = rows[np.argsort(key[rows], kind="stable")]
    if not len(order):
        return []
    groups = np.split(order, np.flatnonzero(np.diff(key[order])) + 1)
    few = [group for group in groups if len(group) < FEWEST_ALIKE]
    mixed = np.concatenate(few) if few else order[:0]
    blocks = [mixed[low : low + MIXED_AT_ONCE] for low in range(0, len(mixed), MIXED_AT_ONCE)]
    return [*(group for group in groups if len(group) >= FEWEST_ALIKE), *blocks]


def _explained(
    samples: CurveSamples,
    weight: np.ndarray,
    rows: np.ndarray,
    places_px: np.ndarray,
    middle_px: np.ndarray,
    node: np.ndarray,
    shape: np.ndarray,
    table: CurveTable,
    black_weight: float,
) -> Float32[np.ndarray, "places rows"]:
    """Return how much of chi-square each place explains, with the best amplitude and background for it.

    The places are ``middle_px`` of each pixel plus ``places_px``, from the pixel's brightest stripe on.
    """
    offset = np.arange(-samples.half_width, samples.half_width + 1)
    first = rows[0]
    if len(rows) >= FEWEST_ALIKE and _one_template(rows, samples, middle_px, node, shape, table):
        kind = table.alignment_of[samples.peak[first] + offset + table.pad]
        entry = table.entry(middle_px[first] + places_px)[:, None] - table.entries_a_step * offset
        curve = table.value[shape[first], node[first]][kind, entry]
    else:
        _, nodes, kinds, entries = table.value.shape
        kind = table.alignment_of[samples.peak[rows] + offset[:, None] + table.pad]
        base = ((shape[rows] * nodes + node[rows]) * kinds + kind) * entries
        entry = table.entry(middle_px[rows] + places_px[:, None])[:, None] - table.entries_a_step * offset[:, None]
        curve = table.value.ravel().take(entry + base)
    weight_of = weight.take(rows, axis=1)
    weighted = weight_of * samples.height.take(rows, axis=1)
    s_mm = _summed(weight_of, curve**2)
    s_mm += np.float32(1e-12)
    s_m = _summed(weight_of, curve)
    toward = _summed(weighted, curve)
    s_1 = weight_of.sum(axis=0) + np.float32(black_weight)
    # Background removed first: what the curve then explains is the drop of chi-square.
    toward -= s_m * (weighted.sum(axis=0) / s_1)
    s_m *= s_m
    s_m /= s_1
    inner = np.subtract(s_mm, s_m, out=s_m)
    s_mm *= np.float32(1e-6)
    np.maximum(inner, s_mm, out=inner)
    # A stripe takes no light away.
    np.maximum(toward, 0.0, out=toward)
    toward *= toward
    toward /= inner
    return toward


def _one_template(
    rows: np.ndarray,
    samples: CurveSamples,
    middle_px: np.ndarray,
    node: np.ndarray,
    shape: np.ndarray,
    table: CurveTable,
) -> bool:
    """Tell whether all rows have footprint, alignment and middle of the first."""
    kind = table.alignment_of[samples.peak[rows] + table.pad]
    return all((values == values[0]).all() for values in (kind, middle_px[rows], node[rows], shape[rows]))


def _summed(weight: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """Return the weighted sums over the samples [places, pixels] of one template for all, or of one for each pixel."""
    if curve.ndim > 2:
        return np.einsum("sp,lsp->lp", weight, curve)
    total = np.empty((len(curve), weight.shape[1]), dtype=np.float32)
    columns = max(ALONE_PRODUCTS // curve.size, 1)
    for low in range(0, weight.shape[1], columns):
        part = slice(low, low + columns)
        np.matmul(curve, weight[:, part], out=total[:, part])
    return total


def _highest(values: Float32[np.ndarray, "places pixels"]) -> Int64[np.ndarray, " pixels"]:
    """Return the first of the places with the highest value: an ``argmax`` over the first axis that keeps to the rows."""
    highest = values[0].copy()
    best = np.zeros(len(highest), dtype=np.int64)
    higher = np.empty(len(highest), dtype=bool)
    for number, row in enumerate(values):
        np.greater(row, highest, out=higher)
        np.copyto(best, number, where=higher)
        np.maximum(highest, row, out=highest)
    return best
