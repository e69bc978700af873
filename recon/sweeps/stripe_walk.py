"""Walk place and width of each pixel's curve to the least chi-square by Gauss–Newton, and look its curve up on the way.

Compiled loops over pixels, some of which lie side by side in the lanes of a core, sample after sample. The machine code that is
kept is told stale by this file alone, so what is compiled here uses nothing of others.
"""

from typing import NamedTuple

import numpy as np

from recon.compiled import compiled

# Pixels worked on at a time: what is made of them stays in a core's nearest cache.
LANES = 32
LARGEST_STEP = 0.5  # of a step of the sweep, and of the logarithm of the width
# The last step is taken and not looked at again: Gauss–Newton leaves a small part of it, and all of it is within the noise.
SETTLED_SD = 0.3
SETTLED_WIDTH_SD = 0.5
# Where the curve is as flat as the background the two are not told apart.
SINGULAR = 1e-7
LEAST = 1e-12
# Indices without a sign: those with one are searched for negative ones.
ONE, TWO, THREE, FOUR, ALL_LANES = (np.uintp(number) for number in (1, 2, 3, 4, LANES))


class TableArrays(NamedTuple):
    """A table of curves (``curve_table.py``) for compiled loops: its arrays in one row each, and its numbers."""

    pairs: (
        np.ndarray
    )  # [shapes · nodes · phases · alignments · steps] int64, each the bits of value and slope in float32
    nodes: int
    alignments: int
    steps: int
    alignment_of: np.ndarray  # [stripes] int64, from −pad on
    pad: int
    entries_a_step: int
    spacing_px: float
    reach_px: float
    step_px: float
    thinnest: float  # logarithm of the first node's width
    node_spacing: float


class Pixels(NamedTuple):
    """The samples of some pixels, their footprints, and the noise: height h has the variance read + gain·h + (relative·h)²."""

    height: np.ndarray  # [pixels, samples] float32, counts above black
    weight: np.ndarray  # one over the variance; zero for samples that may not be used
    peak: np.ndarray  # [pixels] int64, stripe of the middle sample
    shape: np.ndarray  # [pixels] int64
    log_width: np.ndarray  # [pixels] float64, what is known of it
    width_sd: np.ndarray
    read: float
    gain: float
    relative: float


@compiled
def look_up_pixels(
    peak: np.ndarray,
    place_px: np.ndarray,
    shape: np.ndarray,
    log_width: np.ndarray,
    table: TableArrays,
    found: np.ndarray,
) -> None:
    """Write each pixel's curve at its samples, and its derivatives by place and by the width's logarithm.

    ``place_px`` is counted from the place of the stripe ``peak``; ``found`` [3, pixels, samples] float64.
    """
    count = found.shape[2]
    lanes, _, curve, pair = _rooms(count)
    for low in range(0, len(peak), LANES):
        for k in range(LANES):
            lanes[k] = min(low + k, len(peak) - 1)
        _look_up(lanes, place_px, log_width, shape, peak, table, pair, curve)
        for k in range(min(LANES, len(peak) - low)):
            for s in range(count):
                for one in range(3):
                    found[one, low + k, s] = curve[(3 * s + one) * LANES + k]


@compiled
def weigh_pixels(some: np.ndarray, pixels: Pixels, place_px: np.ndarray, table: TableArrays) -> None:
    """Weigh the samples of ``some`` pixels anew, by the heights of curves of known widths at ``place_px``: without noise."""
    number, count = len(some), pixels.height.shape[1]
    lanes, sample, curve, pair = _rooms(count)
    weights = pixels.weight
    for low in range(0, number, LANES):
        for k in range(LANES):
            lanes[k] = some[min(low + k, number - 1)]
        _load(lanes, pixels, sample)
        _look_up(lanes, place_px, pixels.log_width, pixels.shape, pixels.peak, table, pair, curve)
        _weigh(pixels.read, pixels.gain, pixels.relative, curve, sample)
        for k in range(LANES):
            _keep_weights(sample, k, weights, lanes[k])


@compiled
def step_pixels(
    moving: np.ndarray,
    pixels: Pixels,
    table: TableArrays,
    place_px: np.ndarray,
    log_width: np.ndarray,
    objective: np.ndarray,
    fit: np.ndarray,
    weigh: bool,
) -> int:
    """Take one step of Gauss and Newton with the ``moving`` pixels; return how many, now first among them, must go on.

    With ``weigh`` their samples are weighed anew before.

    ``place_px`` (from the peak's on), ``log_width`` and ``objective`` [pixels] float64 are where each pixel is and the least
    chi-square so far, with the prior's part; ``fit`` [8, pixels] float64 the state there: place and its sd in device pixels,
    amplitude, background, logarithm of the width, information on it, chi-square and degrees of freedom.
    """
    count, number = pixels.height.shape[1], len(moving)
    lowest, highest = table.thinnest, table.thinnest + table.node_spacing * (table.nodes - 1)
    limit_px = LARGEST_STEP * table.step_px
    lanes, sample, curve, pair = _rooms(count)
    known_width, known_sd, weights = pixels.log_width, pixels.width_sd, pixels.weight
    left = 0
    for low in range(0, number, LANES):
        for k in range(LANES):
            lanes[k] = moving[min(low + k, number - 1)]
        _load(lanes, pixels, sample)
        _look_up(lanes, place_px, log_width, pixels.shape, pixels.peak, table, pair, curve)
        if weigh:
            _weigh(pixels.read, pixels.gain, pixels.relative, curve, sample)
        found = _linearise(lanes, pixels, log_width, sample, curve, limit_px)
        for k in range(min(LANES, number - low)):
            one = lanes[k]
            place, width = place_px[one], log_width[one]
            off = (width - known_width[one]) / known_sd[one]
            reached = found[7, k] + off * off
            if reached > objective[one]:
                # A step that made things worse is tried again at a third of its length.
                place_px[one] = fit[0, one] + (place - fit[0, one]) / 3.0
                log_width[one] = min(max(fit[4, one] + (width - fit[4, one]) / 3.0, lowest), highest)
                moving[left] = one
                left += 1
                continue
            objective[one] = reached
            fit[0, one], fit[4, one] = place, width
            fit[1, one], fit[2, one], fit[3, one] = found[2, k], found[4, k], found[5, k]
            fit[5, one], fit[6, one], fit[7, one] = found[6, k], found[7, k], found[8, k]
            place += min(max(found[0, k], -limit_px), limit_px)
            width = min(max(width + min(max(found[1, k], -LARGEST_STEP), LARGEST_STEP), lowest), highest)
            if abs(found[0, k]) <= SETTLED_SD * found[2, k] and abs(found[1, k]) <= SETTLED_WIDTH_SD * found[3, k]:
                fit[0, one], fit[4, one] = place, width
            else:
                place_px[one], log_width[one] = place, width
                moving[left] = one
                left += 1
                if weigh:
                    _keep_weights(sample, k, weights, one)
    return left


@compiled
def _rooms(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return room for the numbers of the lanes' pixels, and for what belongs to each of so many samples, the lanes side by side.

    That is height and weight; the curve and its two derivatives; and what these are made of at two nodes. Each lies in one row,
    sample after sample: so the compiler knows how far apart two of them are, and that a loop may take all lanes at once.
    """
    size = count * LANES
    return np.empty(LANES, dtype=np.int64), np.empty(2 * size), np.empty(3 * size), np.empty(2 * size, dtype=np.int64)


@compiled
def _load(lanes: np.ndarray, pixels: Pixels, sample: np.ndarray) -> None:
    """Lay height and weight of the samples of the lanes' pixels side by side."""
    # A field of a tuple is taken out once, which the compiler does not do for a loop.
    height, weight = pixels.height, pixels.weight
    for k in range(ALL_LANES):
        one = np.uintp(lanes[k])
        for s in range(np.uintp(height.shape[1])):
            at = TWO * s * ALL_LANES + k
            sample[at], sample[at + ALL_LANES] = height[one, s], weight[one, s]


@compiled
def _keep_weights(sample: np.ndarray, lane: int, weights: np.ndarray, pixel: int) -> None:
    """Write the weights of a lane's samples to those of its pixel."""
    for s in range(weights.shape[1]):
        weights[pixel, s] = sample[(2 * s + 1) * LANES + lane]


@compiled
def _look_up(
    lanes: np.ndarray,
    place_px: np.ndarray,
    log_width: np.ndarray,
    shape: np.ndarray,
    peak: np.ndarray,
    table: TableArrays,
    pair: np.ndarray,
    curve: np.ndarray,
) -> None:
    """Write the curves of the lanes' pixels at their samples, and the derivatives by place and by the width's logarithm.

    Widths are interpolated between two nodes; places are Taylor-expanded from the nearest entry. ``pair`` is room for values and
    slopes at both nodes.
    """
    count = len(pair) // (2 * LANES)
    half = count // 2
    share, rest_px = np.empty(LANES), np.empty(LANES)
    first, stripe = np.empty(LANES, dtype=np.int64), np.empty(LANES, dtype=np.int64)
    node, step, phase = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    pairs, alignment_of, steps = table.pairs, table.alignment_of, table.steps
    a_step, thinnest, reach_px = float(table.entries_a_step), table.thinnest, table.reach_px
    node_spacing, spacing_px = table.node_spacing, table.spacing_px
    last, last_node = float((steps - 2 * table.pad) * table.entries_a_step - 1), table.nodes - 1.0
    for k in range(ALL_LANES):
        share[k], rest_px[k] = log_width[lanes[k]], place_px[lanes[k]]
    for k in range(ALL_LANES):
        position, from_end = (share[k] - thinnest) / node_spacing, (rest_px[k] + reach_px) / spacing_px
        # Far places lie where every curve is dark; what is no number stays within the table, too, for no index is checked.
        position = min(position if position > 0.0 else 0.0, last_node)
        nearest = np.rint(min(from_end if from_end > 0.0 else 0.0, last))
        node[k] = min(np.floor(position), last_node - 1.0)
        step[k] = np.floor(nearest / a_step)
        phase[k] = nearest - step[k] * a_step
        share[k], rest_px[k] = position - node[k], (from_end - nearest) * spacing_px
    for k in range(ALL_LANES):
        one = np.uintp(lanes[k])
        row = (shape[one] * table.nodes + int(node[k])) * table.entries_a_step + int(phase[k])
        first[k] = row * table.alignments * steps + int(step[k]) + table.pad + half
        stripe[k] = peak[one] + table.pad - half
    to_next = np.uintp(table.entries_a_step * table.alignments * steps)
    for k in range(ALL_LANES):
        at, number = first[k], np.uintp(stripe[k])
        for s in range(np.uintp(count)):
            there, into = np.uintp(at + alignment_of[number + s] * steps), TWO * s * ALL_LANES + k
            pair[into], pair[into + ALL_LANES] = pairs[there], pairs[there + to_next]
            at -= 1
    # Value and slope, by turns.
    both = pair.view(np.float32)
    for s in range(np.uintp(count)):
        near, far, into = FOUR * s * ALL_LANES, (FOUR * s + TWO) * ALL_LANES, THREE * s * ALL_LANES
        for k in range(ALL_LANES):
            value, slope = float(both[near + TWO * k]), float(both[near + TWO * k + ONE])
            wider = float(both[far + TWO * k]) - value
            by_place = slope + share[k] * (float(both[far + TWO * k + ONE]) - slope)
            curve[into + k] = value + share[k] * wider + rest_px[k] * by_place
            curve[into + ALL_LANES + k] = by_place
            curve[into + TWO * ALL_LANES + k] = wider / node_spacing


@compiled
def _weigh(read: float, gain: float, relative: float, curve: np.ndarray, sample: np.ndarray) -> None:
    """Weigh samples by the heights of the curves, whose amplitudes follow from the samples by the two normal equations."""
    sums = np.zeros((5, LANES))
    count = np.uintp(len(sample) // (2 * LANES))
    for s in range(count):
        of, at = TWO * s * ALL_LANES, THREE * s * ALL_LANES
        for k in range(ALL_LANES):
            height, weight, value = sample[of + k], sample[of + ALL_LANES + k], curve[at + k]
            lit = weight * value
            sums[0, k] += weight
            sums[1, k] += weight * height
            sums[2, k] += lit
            sums[3, k] += lit * value
            sums[4, k] += lit * height
    for k in range(ALL_LANES):
        s_1, s_mm = sums[0, k] + 1.0 / read, sums[3, k] + LEAST
        determinant = max(s_mm * s_1 - sums[2, k] * sums[2, k], SINGULAR * s_mm * s_1)
        sums[0, k] = (s_1 * sums[4, k] - sums[2, k] * sums[1, k]) / determinant
    square = relative * relative
    for s in range(count):
        of, at = (TWO * s + ONE) * ALL_LANES, THREE * s * ALL_LANES
        for k in range(ALL_LANES):
            light = max(sums[0, k] * curve[at + k], 0.0)
            variance = read + light * (gain + light * square)
            sample[of + k] = (1.0 if sample[of + k] > 0.0 else 0.0) / variance


@compiled
def _linearise(
    lanes: np.ndarray,
    pixels: Pixels,
    log_width: np.ndarray,
    sample: np.ndarray,
    curve: np.ndarray,
    limit_px: float,
) -> np.ndarray:
    """Solve for amplitude and background, remove from both derivatives what these could do instead, and step.

    Return the steps of place and width, the sd of place and of width, amplitude, background, information on the width, chi-square
    and degrees of freedom [9, lanes].
    """
    sums, gradient, known, found = (
        np.zeros((13, LANES)),
        np.zeros((3, LANES)),
        np.empty((2, LANES)),
        np.empty((9, LANES)),
    )
    black_weight, known_width, known_sd = 1.0 / pixels.read, pixels.log_width, pixels.width_sd
    count = np.uintp(len(sample) // (2 * LANES))
    for s in range(count):
        of, at = TWO * s * ALL_LANES, THREE * s * ALL_LANES
        for k in range(ALL_LANES):
            height, weight = sample[of + k], sample[of + ALL_LANES + k]
            value, by_place, by_width = curve[at + k], curve[at + ALL_LANES + k], curve[at + TWO * ALL_LANES + k]
            lit, place, width = weight * value, weight * by_place, weight * by_width
            sums[0, k] += weight
            sums[1, k] += weight * height
            sums[2, k] += lit
            sums[3, k] += lit * value
            sums[4, k] += lit * height
            sums[5, k] += place
            sums[6, k] += place * value
            sums[7, k] += place * by_place
            sums[8, k] += place * by_width
            sums[9, k] += width
            sums[10, k] += width * value
            sums[11, k] += width * by_width
            sums[12, k] += 1.0 if weight > 0.0 else 0.0
    for k in range(ALL_LANES):
        s_1, s_mm = sums[0, k] + black_weight, sums[3, k] + LEAST
        sums[0, k], sums[3, k] = s_1, s_mm
        determinant = max(s_mm * s_1 - sums[2, k] * sums[2, k], SINGULAR * s_mm * s_1)
        amplitude = (s_1 * sums[4, k] - sums[2, k] * sums[1, k]) / determinant
        background = (s_mm * sums[1, k] - sums[2, k] * sums[4, k]) / determinant
        found[0, k], found[4, k], found[5, k] = determinant, amplitude, background
    for s in range(count):
        of, at = TWO * s * ALL_LANES, THREE * s * ALL_LANES
        for k in range(ALL_LANES):
            residual = sample[of + k] - found[4, k] * curve[at + k] - found[5, k]
            weighted = sample[of + ALL_LANES + k] * residual
            gradient[0, k] += weighted * curve[at + ALL_LANES + k]
            gradient[1, k] += weighted * curve[at + TWO * ALL_LANES + k]
            gradient[2, k] += weighted * residual
    for k in range(ALL_LANES):
        known[0, k], known[1, k] = known_width[lanes[k]] - log_width[lanes[k]], known_sd[lanes[k]]
    for k in range(ALL_LANES):
        s_1, s_m, s_mm, determinant = sums[0, k], sums[2, k], sums[3, k], found[0, k]
        p_1, p_m, w_1, w_m, amplitude = sums[5, k], sums[6, k], sums[9, k], sums[10, k], found[4, k]
        square = amplitude * amplitude
        taken = (s_1 * p_m * p_m - 2.0 * s_m * p_m * p_1 + s_mm * p_1 * p_1) / determinant
        mixed = (s_1 * p_m * w_m - s_m * (p_m * w_1 + p_1 * w_m) + s_mm * p_1 * w_1) / determinant
        width_taken = (s_1 * w_m * w_m - 2.0 * s_m * w_m * w_1 + s_mm * w_1 * w_1) / determinant
        information, mixed = square * (sums[7, k] - taken), square * (sums[8, k] - mixed)
        own, precision = max(square * (sums[11, k] - width_taken), 0.0), 1.0 / (known[1, k] * known[1, k])
        both = own + precision
        # What is left for the place when the width may move with it.
        left = max(information - mixed * mixed / both, LEAST)
        pull = amplitude * gradient[1, k] + precision * known[0, k]
        # Where the curve is flat the step stays within the distance to the next sample.
        step = (amplitude * gradient[0, k] - mixed / both * pull) / (left + 1.0 / (limit_px * limit_px))
        found[0, k], found[1, k], found[2, k] = step, (pull - mixed * step) / both, 1.0 / np.sqrt(left)
        found[3, k], found[6, k] = 1.0 / np.sqrt(both), max(own - mixed * mixed / max(information, LEAST), 0.0)
        found[7, k] = gradient[2, k] + black_weight * found[5, k] * found[5, k]
        found[8, k] = max(sums[12, k] - 2.0 - own / both, 1.0)
    return found
