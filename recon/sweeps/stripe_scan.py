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
# An interval is scanned this far to both sides of its best place, in flat stretches of a curve (``CurveTable.flat_px``), and so
# finely: in device pixels or steps, the smaller, but no more finely than so many to the stretch.
FINE_REACH = 1.25
FINE_PLACES_A_PX = 32
MOST_FINE_PLACES = 64
# Nodes and weights for the mean over a standard normal variable, by Gauss and Hermite's rule of three points.
HERMITE_NODES = (0.0, -np.sqrt(3.0), np.sqrt(3.0))
HERMITE_WEIGHTS = (2 / 3, 1 / 6, 1 / 6)
# Pixels worked on at a time: what is made of them stays in a core's nearest cache.
LANES = 32
# What is loaded and stored for one sample does for three, and the compiler knows how many places there are.
SAMPLES_AT_ONCE = 3
PLACES_AT_ONCE = 32
ZERO, SIXTH, HALF, ONE, FOUR, FIVE = (np.float32(number) for number in (0, 1 / 6, 0.5, 1, 4, 5))
LEAST_SQUARE, LEAST_SHARE = np.float32(1e-12), np.float32(1e-6)
# The exponential of less than this is nothing beside one.
LOWEST, PART = np.float32(-32), np.float32(1 / 64)


class Templates(NamedTuple):
    """Rows of a table of curves with the entries of a scan's places alone, so that these lie side by side.

    ``middle`` is the entry of a place on the stripe's centre, ``spacing_px`` the distance of two places; ``alignment_of`` tells
    for stripe numbers from ``-pad`` on which of the alignments each has.
    """

    rows: np.ndarray  # [rows · alignments · entries] float32
    alignments: int
    entries: int
    middle: int
    places_a_step: int
    spacing_px: float
    step_px: float
    flat_px: float
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
    half = count // 2
    reach = SCAN_STEPS * COARSE_PLACES_A_STEP
    first = np.full(pixels, templates.middle - reach)
    # As many places as are tried at once: the last one to the right would have them tried twice.
    explained = np.empty((LANES, 2 * reach), dtype=np.float32)
    for low in range(0, pixels, LANES):
        high = min(low + LANES, pixels)
        _explain(low, high, height, weight, black_weight, peak, number, templates, first, explained)
        for pixel in range(low, high):
            place_px[pixel] = (_vertex(explained, pixel - low) - reach) * templates.spacing_px
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

    As for ``best_places``, but ``numbers`` [3, pixels] are the rows of the widths of Hermite's rule, the middle one first and -1
    where it does for another: amplitude and background are at their best, the width is averaged over what is known of it.
    ``spread`` [3, pixels] float64.
    """
    flat, pixels = templates.flat_px, len(peak)
    reach = int(np.ceil(FINE_REACH * flat / templates.spacing_px - 1e-9))
    first = np.empty(pixels, dtype=np.int64)
    for pixel in range(pixels):
        # No start lies beyond the window; what is no number does not either, for no index is checked.
        about = about_px[pixel] if abs(about_px[pixel]) < templates.pad * templates.step_px else 0.0
        # The grid's middle is that of the nearest flat stretch.
        middle = np.rint(np.rint(about / flat) * flat / templates.spacing_px)
        first[pixel] = templates.middle + int(middle) - reach
    explained = np.empty((LANES, 2 * reach + 1), dtype=np.float32)
    moments = np.empty((3, LANES, 4))
    for low in range(0, pixels, LANES):
        high = min(low + LANES, pixels)
        for node in range(3):
            _explain(low, high, height, weight, black_weight, peak, numbers[node], templates, first, explained)
            for pixel in range(low, high):
                if numbers[node, pixel] < 0:
                    for m in range(4):
                        moments[node, pixel - low, m] = moments[0, pixel - low, m]
                    continue
                best = _integrate(explained, pixel - low, moments, node)
                if node == 0:
                    spread[2, pixel] = (first[pixel] + best - templates.middle) * templates.spacing_px
        for pixel in range(low, high):
            mean, sd = _combined(moments, pixel - low)
            spread[0, pixel] = (first[pixel] + reach - templates.middle + mean) * templates.spacing_px
            spread[1, pixel] = sd * templates.spacing_px


@compiled
def _explain(
    low: int,
    high: int,
    height: np.ndarray,
    weight: np.ndarray,
    black_weight: float,
    peak: np.ndarray,
    number: np.ndarray,
    templates: Templates,
    first: np.ndarray,
    explained: np.ndarray,
) -> None:
    """Write how much of chi-square each place explains, with its best amplitude and background, for some of the pixels.

    The places begin at entry ``first`` [pixels] of the templates. Pixels without one (``number`` -1) are left out.
    """
    count, places = height.shape[1], explained.shape[1]
    # A field of a tuple is taken out once, which the compiler does not do for a loop.
    rows, alignment_of = templates.rows, templates.alignment_of
    # Samples beyond the last one have no weight.
    single, weighted = np.zeros(count + SAMPLES_AT_ONCE, np.float32), np.zeros(count + SAMPLES_AT_ONCE, np.float32)
    begin = np.zeros(count + SAMPLES_AT_ONCE, np.uintp)
    sums = np.empty((3, PLACES_AT_ONCE), np.float32)
    for pixel in range(low, high):
        if number[pixel] < 0:
            continue
        lane = np.uintp(pixel - low)
        total, pull = black_weight, 0.0
        for s in range(count):
            offset = s - count // 2
            row = number[pixel] * templates.alignments + alignment_of[peak[pixel] + offset + templates.pad]
            begin[s] = np.uintp(row * templates.entries + first[pixel] - templates.places_a_step * offset)
            single[s], weighted[s] = weight[pixel, s], weight[pixel, s] * height[pixel, s]
            total += single[s]
            pull += weighted[s]
        background, share = np.float32(pull / total), np.float32(1.0 / total)
        for part in range(0, places, PLACES_AT_ONCE):
            for k in range(PLACES_AT_ONCE):
                sums[0, k] = sums[1, k] = sums[2, k] = ZERO
            for s in range(0, count, SAMPLES_AT_ONCE):
                # Indices without a sign: those with one are searched for negative ones.
                at_a, at_b, at_c = (
                    begin[s] + np.uintp(part),
                    begin[s + 1] + np.uintp(part),
                    begin[s + 2] + np.uintp(part),
                )
                for k in range(np.uintp(PLACES_AT_ONCE)):
                    a, b, c = rows[at_a + k], rows[at_b + k], rows[at_c + k]
                    one_a, one_b, one_c = single[s] * a, single[s + 1] * b, single[s + 2] * c
                    sums[0, k] += one_a * a + one_b * b + one_c * c
                    sums[1, k] += one_a + one_b + one_c
                    sums[2, k] += weighted[s] * a + weighted[s + 1] * b + weighted[s + 2] * c
            for k in range(PLACES_AT_ONCE):
                # Background removed first: what the curve then explains is the drop of chi-square. A stripe takes no light away.
                toward = max(sums[2, k] - sums[1, k] * background, ZERO)
                whole = sums[0, k] + LEAST_SQUARE
                inner = max(whole - sums[1, k] * sums[1, k] * share, LEAST_SHARE * whole)
                sums[0, k] = toward * toward / inner
            for k in range(np.uintp(min(PLACES_AT_ONCE, places - part))):
                explained[lane, np.uintp(part) + k] = sums[0, k]


@compiled
def _highest(values: np.ndarray, row: int) -> int:
    """Return the first of a row's highest values."""
    highest = values[row, 0]
    for k in range(np.uintp(values.shape[1])):
        highest = max(highest, values[row, k])
    best = 0
    while values[row, best] < highest:
        best += 1
    return best


@compiled
def _vertex(values: np.ndarray, row: int) -> float:
    """Return where the highest of a row's values would be, by a parabola."""
    best = min(max(_highest(values, row), 1), values.shape[1] - 2)
    before, most, after = float(values[row, best - 1]), float(values[row, best]), float(values[row, best + 1])
    curvature = 2.0 * most - before - after
    if curvature <= 0.0:
        return float(best)
    return best + min(max(0.5 * (after - before) / max(curvature, 1e-12), -1.0), 1.0)


@compiled
def _exponential(x: np.float32) -> np.float32:
    """Return exp(x) for x ≤ 0 by operations for all lanes: the 64th power of a Taylor series, exact where exp(x) counts."""
    y = PART * x if x > LOWEST else PART * LOWEST
    series = ONE + y * (ONE + y * (HALF + y * (SIXTH + y * (SIXTH / FOUR + y * (SIXTH / FOUR / FIVE)))))
    for _ in range(6):
        series *= series
    return series


@compiled
def _integrate(explained: np.ndarray, row: int, moments: np.ndarray, node: int) -> int:
    """Write a row's highest value, and mass and moments of its likelihood about its middle, in places; return the likeliest."""
    places = explained.shape[1]
    best = _highest(explained, row)
    highest = explained[row, best]
    mass = first = second = ZERO
    for k in range(places):
        likelihood = _exponential(HALF * (explained[row, k] - highest))
        at = np.float32(k - places // 2)
        mass += likelihood
        first += likelihood * at
        second += likelihood * at * at
    moments[node, row, 0], moments[node, row, 1] = highest, mass
    moments[node, row, 2], moments[node, row, 3] = first, second
    return best


@compiled
def _combined(moments: np.ndarray, row: int) -> tuple[float, float]:
    """Return mean and sd over all widths, each with its share."""
    top = max(moments[0, row, 0], moments[1, row, 0], moments[2, row, 0])
    mass, first, second = 0.0, 0.0, 0.0
    for node in range(3):
        share = HERMITE_WEIGHTS[node] * np.exp(0.5 * (moments[node, row, 0] - top))
        mass += share * moments[node, row, 1]
        first += share * moments[node, row, 2]
        second += share * moments[node, row, 3]
    mean = first / mass
    return mean, np.sqrt(max(second / mass - mean * mean, 0.0))
