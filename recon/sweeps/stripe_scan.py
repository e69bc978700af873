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
# What is loaded and stored for one sample does for four, and the compiler knows how many places there are. Few places at a time
# lie in the dark of most samples' curves.
SAMPLES_AT_ONCE = 4
PLACES_AT_ONCE = 16
FOLDS = 8
ZERO, SIXTH, HALF, ONE, FOUR, FIVE = (np.float32(number) for number in (0, 1 / 6, 0.5, 1, 4, 5))
LEAST_SQUARE, LEAST_SHARE = np.float32(1e-12), np.float32(1e-6)
# The exponential of less than this is nothing beside one.
LOWEST, PART = np.float32(-32), np.float32(1 / 64)


class Templates(NamedTuple):
    """Rows of a table of curves with the entries of a scan's places alone, so that these lie side by side.

    ``middle`` is the entry of a place on the stripe's centre, ``spacing_px`` the distance of two places; ``alignment_of`` tells
    for stripe numbers from ``-pad`` on which of the alignments each has. ``lit`` are the first and the last entry of each row
    that are not dark.
    """

    rows: np.ndarray  # [rows · alignments · entries] float32
    lit: np.ndarray  # [rows, 2] int64
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
    explained, best = np.zeros((LANES, 2 * reach), dtype=np.float32), np.empty(LANES, dtype=np.int64)
    spacing_px, step_px = templates.spacing_px, templates.step_px
    for low in range(0, pixels, LANES):
        high = min(low + LANES, pixels)
        _explain(low, high, height, weight, black_weight, peak, number, templates, first, explained)
        _find_highest(explained, best)
        for pixel in range(np.uintp(low), np.uintp(high)):
            lane = pixel - np.uintp(low)
            place_px[pixel] = (_vertex(explained, lane, best[lane]) - reach) * spacing_px
            least = HALF * height[pixel, np.uintp(half)]
            top, middle = 0, 0
            for s in range(np.uintp(count)):
                on_top = height[pixel, s] > least
                top += 1 if on_top else 0
                middle += int(s) if on_top else 0
            if top > 2 * SCAN_STEPS:
                # The brightest sample of a top that is wider than the scan may be anywhere on it.
                place_px[pixel] = step_px * (middle - half * top) / top


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
    explained, best = np.zeros((LANES, 2 * reach + 1), dtype=np.float32), np.empty(LANES, dtype=np.int64)
    moments = np.empty((3, LANES, 4))
    for low in range(0, pixels, LANES):
        high = min(low + LANES, pixels)
        for node in range(3):
            _explain(low, high, height, weight, black_weight, peak, numbers[node], templates, first, explained)
            _find_highest(explained, best)
            for pixel in range(low, high):
                if numbers[node, pixel] < 0:
                    for m in range(4):
                        moments[node, pixel - low, m] = moments[0, pixel - low, m]
                    continue
                _integrate(explained, pixel - low, best[pixel - low], moments, node)
                if node == 0:
                    spread[2, pixel] = (first[pixel] + best[pixel - low] - templates.middle) * templates.spacing_px
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
    count, places = height.shape[1], np.uintp(explained.shape[1])
    half = count // 2
    # A field of a tuple is taken out once, which the compiler does not do for a loop.
    rows, alignment_of, lit = templates.rows, templates.alignment_of, templates.lit
    entries, alignments, a_step = templates.entries, templates.alignments, templates.places_a_step
    steps_a_place = 1.0 / a_step
    # Samples beyond the last one have no weight.
    single, weighted = np.zeros(count + SAMPLES_AT_ONCE, np.float32), np.zeros(count + SAMPLES_AT_ONCE, np.float32)
    begin = np.zeros(count + SAMPLES_AT_ONCE, np.uintp)
    sums = np.empty((3, PLACES_AT_ONCE), np.float32)
    for pixel in range(np.uintp(low), np.uintp(high)):
        if number[pixel] < 0:
            continue
        lane = pixel - np.uintp(low)
        total, pull = np.float32(black_weight), ZERO
        row, stripe = np.uintp(number[pixel]), np.uintp(peak[pixel] - half + templates.pad)
        at = number[pixel] * alignments * entries + first[pixel] + a_step * half
        for s in range(np.uintp(count)):
            # Indices without a sign: those with one are searched for negative ones.
            begin[s] = np.uintp(at + alignment_of[stripe + s] * entries)
            at -= a_step
            one, pulled = weight[pixel, s], weight[pixel, s] * height[pixel, s]
            single[s], weighted[s] = one, pulled
            total += one
            pull += pulled
        background, share = pull / total, ONE / total
        lit_first, lit_last = first[pixel] - lit[row, np.uintp(0)], first[pixel] - lit[row, np.uintp(1)]
        for part in range(np.uintp(0), places, np.uintp(PLACES_AT_ONCE)):
            # The samples whose curves are not dark at these places; one more or less dark one does not matter.
            least = half + int(np.floor((lit_last + np.intp(part)) * steps_a_place))
            most = half + int(np.floor((lit_first + np.intp(part) + PLACES_AT_ONCE) * steps_a_place))
            for k in range(np.uintp(PLACES_AT_ONCE)):
                sums[0, k] = sums[1, k] = sums[2, k] = ZERO
            for s in range(np.uintp(max(least, 0)), np.uintp(max(min(most + 1, count), 0)), np.uintp(SAMPLES_AT_ONCE)):
                s_b, s_c, s_d = s + np.uintp(1), s + np.uintp(2), s + np.uintp(3)
                at_a, at_b, at_c, at_d = begin[s] + part, begin[s_b] + part, begin[s_c] + part, begin[s_d] + part
                single_a, single_b, single_c, single_d = single[s], single[s_b], single[s_c], single[s_d]
                pull_a, pull_b, pull_c, pull_d = weighted[s], weighted[s_b], weighted[s_c], weighted[s_d]
                for k in range(np.uintp(PLACES_AT_ONCE)):
                    a, b, c, d = rows[at_a + k], rows[at_b + k], rows[at_c + k], rows[at_d + k]
                    one_a, one_b, one_c, one_d = single_a * a, single_b * b, single_c * c, single_d * d
                    sums[0, k] += (one_a * a + one_b * b) + (one_c * c + one_d * d)
                    sums[1, k] += (one_a + one_b) + (one_c + one_d)
                    sums[2, k] += (pull_a * a + pull_b * b) + (pull_c * c + pull_d * d)
            for k in range(np.uintp(PLACES_AT_ONCE)):
                # Background removed first: what the curve then explains is the drop of chi-square. A stripe takes no light away.
                toward = max(sums[2, k] - sums[1, k] * background, ZERO)
                whole = sums[0, k] + LEAST_SQUARE
                inner = max(whole - sums[1, k] * sums[1, k] * share, LEAST_SHARE * whole)
                sums[0, k] = toward * toward / inner
            for k in range(min(np.uintp(PLACES_AT_ONCE), places - part)):
                explained[lane, part + k] = sums[0, k]


@compiled
def _find_highest(values: np.ndarray, best: np.ndarray) -> None:
    """Write where the highest of each row's values is, the first of them."""
    places = np.uintp(values.shape[1])
    whole = places - places % np.uintp(FOLDS)
    # Of so many folds of a row each keeps its highest value, and where it begins.
    most, start = np.empty(FOLDS, np.float32), np.empty(FOLDS, np.int32)
    for row in range(np.uintp(len(values))):
        for j in range(np.uintp(FOLDS)):
            most[j], start[j] = -ONE, 0
        for k in range(np.uintp(0), whole, np.uintp(FOLDS)):
            for j in range(np.uintp(FOLDS)):
                value = values[row, k + j]
                higher = value > most[j]
                most[j] = value if higher else most[j]
                start[j] = np.int32(k) if higher else start[j]
        highest, place = -ONE, np.int64(places)
        for j in range(np.uintp(FOLDS)):
            highest = max(highest, most[j])
        for j in range(np.uintp(FOLDS)):
            at = np.int64(start[j]) + np.int64(j)
            place = min(place, at) if most[j] == highest else place
        for k in range(whole, places):
            if values[row, k] > highest:
                highest, place = values[row, k], np.int64(k)
        best[row] = place


@compiled
def _vertex(values: np.ndarray, row: np.uintp, highest: int) -> float:
    """Return where the highest of a row's values would be, by a parabola."""
    best = min(max(highest, 1), values.shape[1] - 2)
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
def _integrate(explained: np.ndarray, row: int, best: int, moments: np.ndarray, node: int) -> None:
    """Write a row's highest value, at ``best``, and mass and moments of its likelihood about its middle, in places."""
    places = explained.shape[1]
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
