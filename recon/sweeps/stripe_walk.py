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


class TableArrays(NamedTuple):
    """A table of curves (``curve_table.py``) for compiled loops: its arrays in one row each, and its numbers."""

    value: np.ndarray  # [shapes · nodes · alignments · entries] float32
    slope: np.ndarray
    nodes: int
    alignments: int
    entries: int
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
    lanes, curve = np.empty(LANES, dtype=np.int64), np.empty((3, count, LANES))
    for low in range(0, len(peak), LANES):
        for k in range(LANES):
            lanes[k] = min(low + k, len(peak) - 1)
        _look_up(lanes, place_px, log_width, shape, peak, table, curve)
        for k in range(min(LANES, len(peak) - low)):
            for s in range(count):
                for one in range(3):
                    found[one, low + k, s] = curve[one, s, k]


@compiled
def weigh_pixels(some: np.ndarray, pixels: Pixels, place_px: np.ndarray, table: TableArrays) -> None:
    """Weigh the samples of ``some`` pixels anew, by the heights of curves of known widths at ``place_px``: without noise."""
    number, count = len(some), pixels.height.shape[1]
    lanes, curve, sample = np.empty(LANES, dtype=np.int64), np.empty((3, count, LANES)), np.empty((2, count, LANES))
    for low in range(0, number, LANES):
        for k in range(LANES):
            lanes[k] = some[min(low + k, number - 1)]
        _load(lanes, pixels, sample)
        _look_up(lanes, place_px, pixels.log_width, pixels.shape, pixels.peak, table, curve)
        _weigh(lanes, pixels, curve, sample)


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
    chi-square so far, with the prior's part; ``fit`` [pixels, 8] float64 the state there: place and its sd in device pixels,
    amplitude, background, logarithm of the width, information on it, chi-square and degrees of freedom.
    """
    count, number = pixels.height.shape[1], len(moving)
    lowest, highest = table.thinnest, table.thinnest + table.node_spacing * (table.nodes - 1)
    limit_px = LARGEST_STEP * table.step_px
    lanes, curve, sample = np.empty(LANES, dtype=np.int64), np.empty((3, count, LANES)), np.empty((2, count, LANES))
    found = np.empty((9, LANES))
    known_width, known_sd = pixels.log_width, pixels.width_sd
    left = 0
    for low in range(0, number, LANES):
        for k in range(LANES):
            lanes[k] = moving[min(low + k, number - 1)]
        _load(lanes, pixels, sample)
        _look_up(lanes, place_px, log_width, pixels.shape, pixels.peak, table, curve)
        if weigh:
            _weigh(lanes, pixels, curve, sample)
        _linearise(lanes, pixels, log_width, sample, curve, limit_px, found)
        for k in range(min(LANES, number - low)):
            one = lanes[k]
            place, width = place_px[one], log_width[one]
            off = (width - known_width[one]) / known_sd[one]
            reached = found[7, k] + off * off
            if reached > objective[one]:
                # A step that made things worse is tried again at a third of its length.
                place_px[one] = fit[one, 0] + (place - fit[one, 0]) / 3.0
                log_width[one] = min(max(fit[one, 4] + (width - fit[one, 4]) / 3.0, lowest), highest)
                moving[left] = one
                left += 1
                continue
            objective[one] = reached
            fit[one, 0], fit[one, 4] = place, width
            fit[one, 1], fit[one, 2], fit[one, 3] = found[2, k], found[4, k], found[5, k]
            fit[one, 5], fit[one, 6], fit[one, 7] = found[6, k], found[7, k], found[8, k]
            place += min(max(found[0, k], -limit_px), limit_px)
            width = min(max(width + min(max(found[1, k], -LARGEST_STEP), LARGEST_STEP), lowest), highest)
            if abs(found[0, k]) <= SETTLED_SD * found[2, k] and abs(found[1, k]) <= SETTLED_WIDTH_SD * found[3, k]:
                fit[one, 0], fit[one, 4] = place, width
            else:
                place_px[one], log_width[one] = place, width
                moving[left] = one
                left += 1
    return left


@compiled
def _load(lanes: np.ndarray, pixels: Pixels, sample: np.ndarray) -> None:
    """Lay height and weight of the samples of the lanes' pixels side by side."""
    # A field of a tuple is taken out once, which the compiler does not do for a loop.
    height, weight = pixels.height, pixels.weight
    for k in range(LANES):
        for s in range(sample.shape[1]):
            sample[0, s, k] = height[lanes[k], s]
            sample[1, s, k] = weight[lanes[k], s]


@compiled
def _look_up(
    lanes: np.ndarray,
    place_px: np.ndarray,
    log_width: np.ndarray,
    shape: np.ndarray,
    peak: np.ndarray,
    table: TableArrays,
    curve: np.ndarray,
) -> None:
    """Write the curves of the lanes' pixels at their samples, and the derivatives by place and by the width's logarithm.

    Widths are interpolated between two nodes; places are Taylor-expanded from the nearest entry.
    """
    share, rest_px = np.empty(LANES), np.empty(LANES)
    first, stripe = np.empty(LANES, dtype=np.int64), np.empty(LANES, dtype=np.int64)
    values, slopes, alignment_of = table.value, table.slope, table.alignment_of
    dark = table.pad * table.entries_a_step
    last = table.entries - 1 - 2 * dark
    for k in range(LANES):
        one = lanes[k]
        position = (log_width[one] - table.thinnest) / table.node_spacing
        from_end = (place_px[one] + table.reach_px) / table.spacing_px
        # Far places lie where every curve is dark; what is no number stays within the table, too, for no index is checked.
        position = min(position if position > 0.0 else 0.0, table.nodes - 1.0)
        node = min(int(position), table.nodes - 2)
        nearest = np.rint(min(from_end if from_end > 0.0 else 0.0, float(last)))
        share[k], rest_px[k] = position - node, (from_end - nearest) * table.spacing_px
        first[k] = (shape[one] * table.nodes + node) * table.alignments * table.entries + int(nearest) + dark
        stripe[k] = peak[one] + table.pad
    to_next = np.uintp(table.alignments * table.entries)
    for s in range(curve.shape[1]):
        offset = s - curve.shape[1] // 2
        for k in range(LANES):
            kind = alignment_of[np.uintp(stripe[k] + offset)]
            at = np.uintp(first[k] + kind * table.entries - table.entries_a_step * offset)
            value, slope = float(values[at]), float(slopes[at])
            wider = values[at + to_next] - value
            by_place = slope + share[k] * (slopes[at + to_next] - slope)
            curve[0, s, k] = value + share[k] * wider + rest_px[k] * by_place
            curve[1, s, k] = by_place
            curve[2, s, k] = wider / table.node_spacing


@compiled
def _weigh(lanes: np.ndarray, pixels: Pixels, curve: np.ndarray, sample: np.ndarray) -> None:
    """Weigh samples by the heights of the curves, whose amplitudes follow from the samples by the two normal equations."""
    sums = np.zeros((5, LANES))
    for s in range(curve.shape[1]):
        for k in range(LANES):
            height, weight, value = sample[0, s, k], sample[1, s, k], curve[0, s, k]
            sums[0, k] += weight
            sums[1, k] += weight * height
            sums[2, k] += weight * value
            sums[3, k] += weight * value * value
            sums[4, k] += weight * value * height
    for k in range(LANES):
        s_1, s_mm = sums[0, k] + 1.0 / pixels.read, sums[3, k] + LEAST
        determinant = max(s_mm * s_1 - sums[2, k] * sums[2, k], SINGULAR * s_mm * s_1)
        sums[0, k] = (s_1 * sums[4, k] - sums[2, k] * sums[1, k]) / determinant
    for s in range(curve.shape[1]):
        for k in range(LANES):
            light = max(sums[0, k] * curve[0, s, k], 0.0)
            variance = pixels.read + light * (pixels.gain + light * pixels.relative * pixels.relative)
            sample[1, s, k] = 1.0 / variance if sample[1, s, k] > 0.0 else 0.0
    weights = pixels.weight
    for k in range(LANES):
        for s in range(curve.shape[1]):
            weights[lanes[k], s] = sample[1, s, k]


@compiled
def _linearise(
    lanes: np.ndarray,
    pixels: Pixels,
    log_width: np.ndarray,
    sample: np.ndarray,
    curve: np.ndarray,
    limit_px: float,
    found: np.ndarray,
) -> None:
    """Solve for amplitude and background, remove from both derivatives what these could do instead, and step.

    Write the steps of place and width, the sd of place and of width, amplitude, background, information on the width, chi-square
    and degrees of freedom.
    """
    sums = np.zeros((13, LANES))
    black_weight, known_width, known_sd = 1.0 / pixels.read, pixels.log_width, pixels.width_sd
    for s in range(curve.shape[1]):
        for k in range(LANES):
            height, weight = sample[0, s, k], sample[1, s, k]
            value, by_place, by_width = curve[0, s, k], curve[1, s, k], curve[2, s, k]
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
    for k in range(LANES):
        s_1, s_mm = sums[0, k] + black_weight, sums[3, k] + LEAST
        sums[0, k], sums[3, k] = s_1, s_mm
        determinant = max(s_mm * s_1 - sums[2, k] * sums[2, k], SINGULAR * s_mm * s_1)
        found[0, k] = determinant
        found[4, k] = (s_1 * sums[4, k] - sums[2, k] * sums[1, k]) / determinant
        found[5, k] = (s_mm * sums[1, k] - sums[2, k] * sums[4, k]) / determinant
    gradient = np.zeros((3, LANES))
    for s in range(curve.shape[1]):
        for k in range(LANES):
            residual = sample[0, s, k] - found[4, k] * curve[0, s, k] - found[5, k]
            weighted = sample[1, s, k] * residual
            gradient[0, k] += weighted * curve[1, s, k]
            gradient[1, k] += weighted * curve[2, s, k]
            gradient[2, k] += weighted * residual
    for k in range(LANES):
        s_1, s_m, s_mm, determinant = sums[0, k], sums[2, k], sums[3, k], found[0, k]
        p_1, p_m, w_1, w_m = sums[5, k], sums[6, k], sums[9, k], sums[10, k]
        amplitude, background = found[4, k], found[5, k]
        square = amplitude * amplitude
        taken = (s_1 * p_m * p_m - 2.0 * s_m * p_m * p_1 + s_mm * p_1 * p_1) / determinant
        mixed = (s_1 * p_m * w_m - s_m * (p_m * w_1 + p_1 * w_m) + s_mm * p_1 * w_1) / determinant
        width_taken = (s_1 * w_m * w_m - 2.0 * s_m * w_m * w_1 + s_mm * w_1 * w_1) / determinant
        information, mixed = square * (sums[7, k] - taken), square * (sums[8, k] - mixed)
        own = max(square * (sums[11, k] - width_taken), 0.0)
        precision = 1.0 / (known_sd[lanes[k]] * known_sd[lanes[k]])
        both = own + precision
        # What is left for the place when the width may move with it.
        left = max(information - mixed * mixed / both, LEAST)
        pull = amplitude * gradient[1, k] + precision * (known_width[lanes[k]] - log_width[lanes[k]])
        # Where the curve is flat the step stays within the distance to the next sample.
        step = (amplitude * gradient[0, k] - mixed / both * pull) / (left + 1.0 / (limit_px * limit_px))
        found[0, k], found[1, k] = step, (pull - mixed * step) / both
        found[2, k], found[3, k] = 1.0 / np.sqrt(left), 1.0 / np.sqrt(both)
        found[6, k] = max(own - mixed * mixed / max(information, LEAST), 0.0)
        found[7, k] = gradient[2, k] + black_weight * background * background
        found[8, k] = max(sums[12, k] - 2.0 - own / both, 1.0)
