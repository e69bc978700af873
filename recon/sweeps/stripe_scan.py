"""Try many places at once: chi-square of every pixel's curve over a grid of places.

A fit that walks downhill may stop at the wrong device pixel of a stepped curve, and where the curve fixes the place only
to an interval (a stripe seen in one photo alone, a footprint inside one device pixel) the curvature at the best place
means nothing. The grid sees both: its best place is where the walk starts, and the spread of the likelihood over it is the
standard deviation of such a place.

Pixels are gone through one by one, compiled; the machine code that is kept is told stale by this file alone, so what is compiled
here uses nothing of others.
"""

from typing import NamedTuple

import numpy as np

from recon.compiled import compiled

# The stripe that looks brightest is rarely farther than this from the place, in steps.
SCAN_STEPS = 2
COARSE_PLACES_A_STEP = 8
# An interval is scanned at least this finely, and this far to both sides of its best place, in device pixels or steps (the
# smaller).
FINE_PLACES_A_PX = 32
FINE_REACH_PX = 1.25
# Nodes and weights for the mean over a standard normal variable, by Gauss and Hermite's rule of three points.
HERMITE_NODES = (-np.sqrt(3.0), 0.0, np.sqrt(3.0))
HERMITE_WEIGHTS = (1 / 6, 2 / 3, 1 / 6)
MIDDLE = 1
ONE, ZERO, HALF = np.float32(1), np.float32(0), np.float32(0.5)
LEAST_SQUARE, LEAST_SHARE = np.float32(1e-12), np.float32(1e-6)
# The exponential of less than this is nothing beside one.
LOWEST, PART = np.float32(-32), np.float32(1 / 64)


class Templates(NamedTuple):
    """Rows of a table of curves with the entries of a scan's places alone, so that these lie side by side.

    ``middle`` is the entry of a place on the stripe's centre, ``spacing_px`` the distance of two places; ``alignment_of`` tells
    for stripe numbers from ``-pad`` on which of the alignments each has.
    """

    rows: np.ndarray  # [rows, alignments, entries] float32
    middle: int
    places_a_step: int
    spacing_px: float
    step_px: float
    alignment_of: np.ndarray  # [stripes] int64
    pad: int


@compiled
def best_places(
    height: np.ndarray,
    weight: np.ndarray,
    black_weight: float,
    peak: np.ndarray,
    number: np.ndarray,
    templates: Templates,
    place_px: np.ndarray,
) -> None:
    """Write the place of least chi-square within two steps of the brightest sample, refined by a parabola.

    ``height`` and ``weight`` [pixels, samples] float32 are those of the samples, ``peak`` [pixels] the stripe of the middle one,
    ``number`` the row of each pixel among the templates; ``place_px`` [pixels] is counted from the peak's place. One shape of
    footprint does for all: the walk that starts there knows each pixel's own.
    """
    pixels, count = height.shape
    reach = SCAN_STEPS * COARSE_PLACES_A_STEP
    sums = np.empty((3, 2 * reach + 1), dtype=np.float32)
    for pixel in range(pixels):
        _explain(
            height[pixel],
            weight[pixel],
            black_weight,
            peak[pixel],
            templates,
            number[pixel],
            templates.middle - reach,
            sums,
        )
        place_px[pixel] = (_vertex(sums[2]) - reach) * templates.spacing_px
        half = count // 2
        top, middle = 0, 0
        for s in range(count):
            if height[pixel, s] > HALF * height[pixel, half]:
                top += 1
                middle += s - half
        if top > 2 * SCAN_STEPS:
            # The brightest sample of a top that is wider than the scan may be anywhere on it.
            place_px[pixel] = templates.step_px * middle / top


@compiled
def place_spreads(
    height: np.ndarray,
    weight: np.ndarray,
    black_weight: float,
    peak: np.ndarray,
    numbers: np.ndarray,
    templates: Templates,
    about_px: np.ndarray,
    spread: np.ndarray,
) -> None:
    """Write mean and sd of the place under its likelihood over a fine grid about a place, and the likeliest place.

    As for ``best_places``, but ``numbers`` [pixels, 3] are the rows of the widths of Hermite's rule: amplitude and background are
    at their best, the width is averaged over what is known of it. ``spread`` [3, pixels] float64.
    """
    unit = min(templates.step_px, 1.0)
    reach = int(np.ceil(FINE_REACH_PX * unit / templates.spacing_px - 1e-9))
    sums = np.empty((3, 2 * reach + 1), dtype=np.float32)
    moments = np.empty((3, 4))
    for pixel in range(len(peak)):
        # The grid's middle is that of the nearest device pixel.
        middle = round(np.rint(about_px[pixel] / unit) * unit / templates.spacing_px)
        likeliest = 0
        for node in (MIDDLE, 0, 2):
            if node != MIDDLE and numbers[pixel, node] == numbers[pixel, MIDDLE]:
                # A width that is known well has one node, and one scan.
                moments[node] = moments[MIDDLE]
                continue
            _explain(
                height[pixel],
                weight[pixel],
                black_weight,
                peak[pixel],
                templates,
                numbers[pixel, node],
                templates.middle + middle - reach,
                sums,
            )
            best = _highest(sums[2])
            if node == MIDDLE:
                likeliest = best
            _integrate(sums[2], sums[2, best], moments[node])
        mean, sd = _combined(moments)
        spread[0, pixel] = (middle + mean) * templates.spacing_px
        spread[1, pixel] = sd * templates.spacing_px
        spread[2, pixel] = (middle + likeliest - reach) * templates.spacing_px


@compiled
def _explain(
    height: np.ndarray,
    weight: np.ndarray,
    black_weight: float,
    peak: int,
    templates: Templates,
    number: int,
    first: int,
    sums: np.ndarray,
) -> None:
    """Write into the last row of ``sums`` how much of chi-square each place explains, with its best amplitude and background."""
    count, places = len(height), sums.shape[1]
    square, light, toward = sums[0], sums[1], sums[2]
    sums[:] = ZERO
    total, pull = black_weight, 0.0
    for s in range(count):
        if weight[s] == ZERO:
            continue
        weighted = weight[s] * height[s]
        total += weight[s]
        pull += weighted
        offset = s - count // 2
        begin = first - templates.places_a_step * offset
        curve = templates.rows[number, templates.alignment_of[peak + offset + templates.pad], begin : begin + places]
        for k in range(places):
            one = weight[s] * curve[k]
            square[k] += one * curve[k]
            light[k] += one
            toward[k] += weighted * curve[k]
    # Background removed first: what the curve then explains is the drop of chi-square.
    background, share = np.float32(pull / total), np.float32(1.0 / total)
    for k in range(places):
        # A stripe takes no light away.
        part = max(toward[k] - light[k] * background, ZERO)
        whole = square[k] + LEAST_SQUARE
        toward[k] = part * part / max(whole - light[k] * light[k] * share, LEAST_SHARE * whole)


@compiled
def _highest(values: np.ndarray) -> int:
    best = 0
    for k in range(len(values)):
        if values[k] > values[best]:
            best = k
    return best


@compiled
def _vertex(values: np.ndarray) -> float:
    """Return where the highest of the values would be, by a parabola."""
    best = min(max(_highest(values), 1), len(values) - 2)
    before, most, after = float(values[best - 1]), float(values[best]), float(values[best + 1])
    curvature = 2.0 * most - before - after
    if curvature <= 0.0:
        return float(best)
    return best + min(max(0.5 * (after - before) / max(curvature, 1e-12), -1.0), 1.0)


@compiled
def _exponential(x: float) -> float:
    """Return exp(x) in single precision for x ≤ 0, by operations that run on all lanes: Taylor's series of a 64th of it."""
    y = max(x, LOWEST) * PART
    series = ONE
    for n in (7, 6, 5, 4, 3, 2, 1):
        series = ONE + series * y * np.float32(1 / n)
    for _ in range(6):
        series *= series
    return series


@compiled
def _integrate(explained: np.ndarray, highest: float, moments: np.ndarray) -> None:
    """Write the highest of the values, and mass and moments of the likelihood over the grid, about its middle, in places."""
    reach = len(explained) // 2
    mass = first = second = ZERO
    for k in range(len(explained)):
        likelihood = _exponential(HALF * (explained[k] - highest))
        at = np.float32(k - reach)
        mass += likelihood
        first += likelihood * at
        second += likelihood * at * at
    moments[0], moments[1], moments[2], moments[3] = highest, mass, first, second


@compiled
def _combined(moments: np.ndarray) -> tuple[float, float]:
    """Return mean and sd over all widths, each with its share."""
    top = max(moments[0, 0], moments[1, 0], moments[2, 0])
    mass, first, second = 0.0, 0.0, 0.0
    for node in range(3):
        share = HERMITE_WEIGHTS[node] * np.exp(0.5 * (moments[node, 0] - top))
        mass += share * moments[node, 1]
        first += share * moments[node, 2]
        second += share * moments[node, 3]
    mean = first / mass
    return mean, np.sqrt(max(second / mass - mean * mean, 0.0))
