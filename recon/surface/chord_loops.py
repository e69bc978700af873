"""Compiled loops over the pairs of neighbours whose equations :mod:`recon.surface.ray_chords` writes down."""

import numpy as np

from recon.compiled import compiled

TINY = float(np.finfo(np.float32).tiny)


@compiled
def write_chords(
    first: np.ndarray,
    second: np.ndarray,
    origin: np.ndarray,
    direction: np.ndarray,
    normal: np.ndarray,
    distance: np.ndarray,
    at_first: np.ndarray,
    at_second: np.ndarray,
    right: np.ndarray,
    turn: np.ndarray,
    chord: np.ndarray,
) -> None:
    """Write each pair's equation without its bend, and how much the normal turns along the chord."""
    whole = np.empty(3)
    for pair in range(len(first)):
        one, other = first[pair], second[pair]
        squared = 0.0
        for k in range(3):
            squared += (normal[one, k] + normal[other, k]) ** 2
        shorter = 1 / max(np.sqrt(squared), TINY)
        apart, half = 0.5 * (distance[one] + distance[other]), 0.0
        before = after = between = 0.0
        for k in range(3):
            mean = shorter * (normal[one, k] + normal[other, k])
            before -= mean * direction[one, k]
            after += mean * direction[other, k]
            # The chord without the noise of the distances: go from ray to ray at the mean distance, then along the ray onto
            # the tangent plane.
            step = origin[other, k] - origin[one, k]
            between += mean * step
            whole[k] = step + apart * (direction[other, k] - direction[one, k])
            half += 0.5 * mean * whole[k]
        slope = 0.5 * (after - before)
        half /= slope if abs(slope) > 1e-6 else 1e-6
        turned = 0.0
        for k in range(3):
            whole[k] -= half * (direction[one, k] + direction[other, k])
            turned += (normal[other, k] - normal[one, k]) * whole[k]
            chord[pair, k] = whole[k]
        at_first[pair], at_second[pair], right[pair], turn[pair] = before, after, -between, turned


@compiled
def write_bend(
    squared_length: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    first: int,
    end: int,
    per_squared: np.ndarray,
    factor: np.ndarray,
) -> None:
    """Write what :class:`Bend` needs of the chords from ``first`` on: one over their squared lengths, and their factors."""
    for pair in range(first, end):
        squared = max(squared_length[pair], TINY)
        per_squared[pair] = 1 / squared
        factor[pair] = 0.0
        if before[pair] >= 0 and after[pair] >= 0:
            length = np.sqrt(squared)
            beside = np.sqrt(max(squared_length[before[pair]], TINY)) + np.sqrt(max(squared_length[after[pair]], TINY))
            apart = length + 0.5 * beside
            # On a steep rim chords grow fast, and a curvature far away says little of this one.
            if apart < 4 * length:
                factor[pair] = squared * length / (12 * apart)


@compiled
def add_height(
    turn: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    per_squared: np.ndarray,
    factor: np.ndarray,
    first: int,
    end: int,
    right: np.ndarray,
) -> None:
    """Add the heights of the chords' bends from ``first`` on, for how much the normal turns along each."""
    for pair in range(first, end):
        if factor[pair] != 0:
            one, other = before[pair], after[pair]
            right[pair] += factor[pair] * (turn[other] * per_squared[other] - turn[one] * per_squared[one])


@compiled
def write_residual(
    first: np.ndarray,
    second: np.ndarray,
    at_first: np.ndarray,
    at_second: np.ndarray,
    right: np.ndarray,
    distance: np.ndarray,
    left: np.ndarray,
) -> None:
    """Write what distances leave of each pair's equation."""
    for pair in range(len(right)):
        told = at_first[pair] * distance[first[pair]] + at_second[pair] * distance[second[pair]]
        left[pair] = told - right[pair]


@compiled
def write_variance(
    first: np.ndarray,
    second: np.ndarray,
    squared_length: np.ndarray,
    tilt_variance: np.ndarray,
    shortest: float,
    least: float,
    variance: np.ndarray,
) -> None:
    """Write the variance of each pair's equation.

    A normal serves both pairs on its line, so that along a line its error adds up whole: one tilt's variance a pixel.
    """
    for pair in range(len(first)):
        tilt = 0.5 * (tilt_variance[first[pair]] + tilt_variance[second[pair]])
        variance[pair] = max(max(squared_length[pair], shortest) * tilt, least)
