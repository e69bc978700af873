"""Walk place and width of each pixel's curve to the least chi-square by Gauss–Newton, and look its curve up on the way.

Pixels are gone through one by one, compiled; the machine code that is kept is told stale by this file alone, so what is compiled
here uses nothing of others.
"""

from typing import NamedTuple

import numpy as np

from recon.compiled import compiled

GAUSS_NEWTON_STEPS = 6
LARGEST_STEP = 0.5  # of a step of the sweep, and of the logarithm of the width
# The last step is taken and not looked at again: Gauss–Newton leaves a small part of it, and all of it is within the noise.
SETTLED_SD = 0.3
SETTLED_WIDTH_SD = 0.5
# Where the curve is as flat as the background the two are not told apart.
SINGULAR = 1e-7


class TableArrays(NamedTuple):
    """A table of curves (``curve_table.py``), as arrays and numbers; where it lacks one, that is marked as ``wanted``."""

    value: np.ndarray  # [shapes, nodes, alignments, entries] float32
    slope: np.ndarray
    filled: np.ndarray  # [shapes, nodes] bool
    wanted: np.ndarray
    alignment_of: np.ndarray  # [stripes] int64, from −pad on
    pad: int
    entries_a_step: int
    spacing_px: float
    reach_px: float
    step_px: float
    thinnest: float  # logarithm of the first node's width
    node_spacing: float


@compiled
def look_up_pixels(
    peak: np.ndarray,
    place_px: np.ndarray,
    shape: np.ndarray,
    log_width: np.ndarray,
    curves: TableArrays,
    found: np.ndarray,
) -> bool:
    """Write each pixel's curve at its samples, and its derivatives by place and by the width's logarithm.

    ``place_px`` is counted from the place of the stripe ``peak``; ``found`` [pixels, 3, samples] float64. Return whether the
    table had them all.
    """
    complete = True
    for pixel in range(len(peak)):
        complete &= _look_up(place_px[pixel], log_width[pixel], shape[pixel], peak[pixel], curves, found[pixel])
    return complete


@compiled
def light_of_pixels(
    height: np.ndarray,
    weight: np.ndarray,
    black_weight: float,
    peak: np.ndarray,
    place_px: np.ndarray,
    shape: np.ndarray,
    log_width: np.ndarray,
    curves: TableArrays,
    light: np.ndarray,
) -> bool:
    """Write the counts above background [pixels, samples] of each pixel's curve, with the amplitude that its samples give it.

    Arguments as for ``walk_pixels``. Return whether the table had all curves.
    """
    pixels, count = height.shape
    curve = np.empty((3, count))
    complete = True
    for pixel in range(pixels):
        complete &= _look_up(place_px[pixel], log_width[pixel], shape[pixel], peak[pixel], curves, curve)
        s_1, s_y, s_m, s_mm, s_my = black_weight, 0.0, 0.0, 1e-12, 0.0
        for s in range(count):
            weighted, value = weight[pixel, s], curve[0, s]
            s_1 += weighted
            s_y += weighted * height[pixel, s]
            s_m += weighted * value
            s_mm += weighted * value * value
            s_my += weighted * value * height[pixel, s]
        amplitude = (s_1 * s_my - s_m * s_y) / max(s_mm * s_1 - s_m * s_m, SINGULAR * s_mm * s_1)
        for s in range(count):
            light[pixel, s] = amplitude * curve[0, s]
    return complete


@compiled
def walk_pixels(
    height: np.ndarray,
    weight: np.ndarray,
    black_weight: float,
    peak: np.ndarray,
    start_px: np.ndarray,
    shape: np.ndarray,
    known_width: np.ndarray,
    known_sd: np.ndarray,
    curves: TableArrays,
    fit: np.ndarray,
    done: np.ndarray,
) -> int:
    """Walk all pixels that are not ``done``; return how many are left because the table lacks a curve on their way.

    ``height`` and ``weight`` [pixels, samples] float32 are those of the samples, ``peak`` [pixels] the stripe of the middle one.
    ``fit`` [pixels, 8] float64: place (from the peak's on, like ``start_px``) and its sd in device pixels, amplitude, background,
    logarithm of the width, information on it, chi-square and degrees of freedom.
    """
    pixels, count = height.shape
    curve = np.empty((3, count))
    sample = np.empty((2, count))
    left = 0
    for pixel in range(pixels):
        if done[pixel]:
            continue
        sample[0], sample[1] = height[pixel], weight[pixel]
        done[pixel] = _walk(
            start_px[pixel],
            known_width[pixel],
            known_sd[pixel],
            shape[pixel],
            peak[pixel],
            black_weight,
            curves,
            sample,
            curve,
            fit[pixel],
        )
        left += not done[pixel]
    return left


@compiled
def _walk(
    start_px: float,
    known_width: float,
    known_sd: float,
    shape: int,
    peak: int,
    black_weight: float,
    curves: TableArrays,
    sample: np.ndarray,
    curve: np.ndarray,
    fit: np.ndarray,
) -> bool:
    """Walk one pixel; False where the table lacks a curve on the way."""
    lowest = curves.thinnest
    highest = lowest + curves.node_spacing * (curves.value.shape[1] - 1)
    limit_px = LARGEST_STEP * curves.step_px
    precision = 1.0 / (known_sd * known_sd)
    place, log_width = start_px, known_width
    best_objective = np.inf
    for _ in range(GAUSS_NEWTON_STEPS):
        if not _look_up(place, log_width, shape, peak, curves, curve):
            return False
        difference = log_width - known_width
        (place_step, width_step, width_sd, sd, amplitude, background, information, chi_square, freedom) = _linearise(
            sample, curve, black_weight, precision, difference, limit_px
        )
        objective = chi_square + precision * difference * difference
        if objective > best_objective:
            # A step that made things worse is tried again at a third of its length.
            place = fit[0] + (place - fit[0]) / 3.0
            log_width = min(max(fit[4] + (log_width - fit[4]) / 3.0, lowest), highest)
            continue
        best_objective = objective
        fit[0], fit[1], fit[2], fit[3] = place, sd, amplitude, background
        fit[4], fit[5], fit[6], fit[7] = log_width, information, chi_square, freedom
        place += min(max(place_step, -limit_px), limit_px)
        log_width = min(max(log_width + min(max(width_step, -LARGEST_STEP), LARGEST_STEP), lowest), highest)
        if abs(place_step) <= SETTLED_SD * sd and abs(width_step) <= SETTLED_WIDTH_SD * width_sd:
            fit[0], fit[4] = place, log_width
            break
    return True


@compiled
def _look_up(
    distance_px: float, log_width: float, shape: int, peak: int, curves: TableArrays, curve: np.ndarray
) -> bool:
    """Write a pixel's curve at its samples, and its derivatives by place and by the width's logarithm; False where none is there.

    Widths are interpolated between two nodes; places are Taylor-expanded from the nearest entry.
    """
    nodes, entries = curves.value.shape[1], curves.value.shape[3]
    position = min(max((log_width - curves.thinnest) / curves.node_spacing, 0.0), nodes - 1.0)
    node = min(int(position), nodes - 2)
    if not (curves.filled[shape, node] and curves.filled[shape, node + 1]):
        curves.wanted[shape, node] = curves.wanted[shape, node + 1] = True
        return False
    share = position - node
    dark = curves.pad * curves.entries_a_step
    from_end = (distance_px + curves.reach_px) / curves.spacing_px
    # Far places lie where every curve is dark.
    nearest = np.rint(min(max(from_end, 0.0), entries - 1.0 - 2.0 * dark))
    rest_px = (from_end - nearest) * curves.spacing_px
    count = curve.shape[1]
    for s in range(count):
        offset = s - count // 2
        kind = curves.alignment_of[peak + offset + curves.pad]
        entry = int(nearest) + dark - curves.entries_a_step * offset
        value, slope = curves.value[shape, node, kind, entry], curves.slope[shape, node, kind, entry]
        wider = float(curves.value[shape, node + 1, kind, entry] - value)
        by_place = slope + share * float(curves.slope[shape, node + 1, kind, entry] - slope)
        curve[0, s] = value + share * wider + rest_px * by_place
        curve[1, s] = by_place
        curve[2, s] = wider / curves.node_spacing
    return True


@compiled
def _linearise(
    sample: np.ndarray, curve: np.ndarray, black_weight: float, precision: float, difference: float, limit_px: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Solve for amplitude and background, remove from both derivatives what these could do instead, and step.

    ``difference`` is what the width's logarithm differs from the one that is known, to ``precision``. Return the steps of place
    and width, the sd of width and of place, amplitude, background, information on the width, chi-square and degrees of freedom.
    """
    count = sample.shape[1]
    s_1, s_y, s_m, s_mm, s_my, usable = black_weight, 0.0, 0.0, 1e-12, 0.0, 0.0
    p_m, p_1, p_p, w_m, w_1, w_w, p_w = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for s in range(count):
        height, weight = sample[0, s], sample[1, s]
        value, by_place, by_width = curve[0, s], curve[1, s], curve[2, s]
        usable += 1.0 if weight > 0.0 else 0.0
        s_1 += weight
        s_y += weight * height
        lit = weight * value
        s_m += lit
        s_mm += lit * value
        s_my += lit * height
        place, width = weight * by_place, weight * by_width
        p_1 += place
        p_m += place * value
        p_p += place * by_place
        p_w += place * by_width
        w_1 += width
        w_m += width * value
        w_w += width * by_width
    determinant = max(s_mm * s_1 - s_m * s_m, SINGULAR * s_mm * s_1)
    amplitude = (s_1 * s_my - s_m * s_y) / determinant
    background = (s_mm * s_y - s_m * s_my) / determinant
    chi_square, place_gradient, width_gradient = black_weight * background * background, 0.0, 0.0
    for s in range(count):
        residual = sample[0, s] - amplitude * curve[0, s] - background
        weighted = sample[1, s] * residual
        chi_square += weighted * residual
        place_gradient += weighted * curve[1, s]
        width_gradient += weighted * curve[2, s]
    square = amplitude * amplitude
    information = square * (p_p - (s_1 * p_m * p_m - 2.0 * s_m * p_m * p_1 + s_mm * p_1 * p_1) / determinant)
    mixed = square * (p_w - (s_1 * p_m * w_m - s_m * (p_m * w_1 + p_1 * w_m) + s_mm * p_1 * w_1) / determinant)
    own = square * (w_w - (s_1 * w_m * w_m - 2.0 * s_m * w_m * w_1 + s_mm * w_1 * w_1) / determinant)
    own = max(own, 0.0)
    place_gradient *= amplitude
    width_gradient = amplitude * width_gradient - precision * difference
    both = own + precision
    # What is left for the place when the width may move with it.
    left = max(information - mixed * mixed / both, 1e-12)
    # Where the curve is flat the step stays within the distance to the next sample.
    damped = left + 1.0 / (limit_px * limit_px)
    place_step = (place_gradient - mixed / both * width_gradient) / damped
    return (
        place_step,
        (width_gradient - mixed * place_step) / both,
        1.0 / np.sqrt(both),
        1.0 / np.sqrt(left),
        amplitude,
        background,
        max(own - mixed * mixed / max(information, 1e-12), 0.0),
        chi_square,
        max(usable - 2.0 - own / both, 1.0),
    )
