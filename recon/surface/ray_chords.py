"""The light paths of a mask's pixels, and the equation that a normal writes down for each pair of neighbours."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from recon.compiled import compiled
from recon.surface.neighbours import Neighbours

VectorMap = Float64[np.ndarray, "rows cols 3"]
ScalarMap = Float64[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]
PerPair = Float64[np.ndarray, " pairs"]
PerPixel = Float64[np.ndarray, " pixels"]
# Single precision is enough for all but the equations themselves: their distances may be a million times their sd.
SmallPerPair = Float32[np.ndarray, " pairs"]

# Chords are never trusted more than this share of a distance's sd: beyond it double precision ends, and an error of a
# chord adds up over a thousand pixels to only 30 times as much.
SMALLEST_CHORD_SHARE = 1e-4
# A normal of which nothing is known still points into the liquid: about so far from the middle of a hemisphere. A pixel
# with such a normal stays tied to its neighbours.
LARGEST_NORMAL_SD_RAD = 1.0
TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """The used pixels, row by row.

    ``measured_mm`` is the triangulated distance, 0 with ``precision`` (1 / variance) 0 where there is none.
    ``tilt_variance`` is that of one of the normal's two tilts.
    """

    origin: Float64[np.ndarray, "pixels 3"]
    direction: Float64[np.ndarray, "pixels 3"]
    measured_mm: PerPixel
    precision: PerPixel
    normal: Float64[np.ndarray, "pixels 3"]
    tilt_variance: PerPixel


@dataclass(frozen=True, slots=True, eq=False)
class Chords:
    """One equation a pair: at_first t_first + at_second t_second = right, with this variance.

    ``chord_mm`` is the chord itself, on the tangent plane.
    """

    at_first: PerPair
    at_second: PerPair
    right: PerPair
    variance: SmallPerPair
    chord_mm: Float32[np.ndarray, "pairs 3"]
    bend: "Bend"

    def residual(self, graph: Neighbours, distance: PerPixel) -> PerPair:
        """Return by how much each chord leaves its tangent plane, in mm."""
        left = np.empty(len(self.right))
        _write_residual(graph.first, graph.second, self.at_first, self.at_second, self.right, distance, left)
        return left


def measured_pixels(distance_mm: ScalarMap, distance_sd_mm: ScalarMap) -> Mask:
    """Return the pixels whose triangulated distance can count."""
    return np.isfinite(distance_mm) & np.isfinite(distance_sd_mm) & (distance_sd_mm > 0)


def rays_of(
    origin_mm: VectorMap,
    direction: VectorMap,
    distance_mm: ScalarMap,
    distance_sd_mm: ScalarMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
    used: Mask,
) -> Rays:
    """Gather what is known of the used pixels."""
    measured = measured_pixels(distance_mm, distance_sd_mm)[used]
    variance = np.where(measured, distance_sd_mm[used], np.inf) ** 2
    return Rays(
        origin=origin_mm[used],
        direction=direction[used],
        measured_mm=np.where(measured, distance_mm[used], 0.0),
        precision=1 / variance,
        normal=normal[used],
        tilt_variance=np.minimum(normal_sd_rad[used], LARGEST_NORMAL_SD_RAD) ** 2 / 2,
    )


def chords_of(
    rays: Rays,
    graph: Neighbours,
    beyond: tuple[Int32[np.ndarray, " pairs"], Int32[np.ndarray, " pairs"]],
    distance: PerPixel,
) -> Chords:
    """Write down every pair's equation and its variance, for a surface near ``distance``.

    ``beyond`` are the pairs before and after each, as :func:`~recon.surface.neighbours.pairs_beyond` tells them.
    """
    pairs = len(graph.first)
    at_first, at_second, right, turn = (np.empty(pairs) for _ in range(4))
    variance, per_squared, factor = (np.empty(pairs, np.float32) for _ in range(3))
    chord_mm = np.empty((pairs, 3), np.float32)
    ends = (graph.first, graph.second)
    _write_chords(*ends, rays.origin, rays.direction, rays.normal, distance, at_first, at_second, right, turn, chord_mm)
    squared_length = np.einsum("pi,pi->p", chord_mm, chord_mm)
    _write_bend(squared_length, *beyond, per_squared, factor)
    _add_height(turn, *beyond, per_squared, factor, right)
    # Two pixels that share a ray are as far apart as rounding says.
    least = 1e-6 * float(np.median(squared_length)) if pairs else 0.0
    _write_variance(*ends, squared_length, rays.tilt_variance, least, _smallest_variance(rays), variance)
    return Chords(at_first, at_second, right, variance, chord_mm, Bend(*beyond, per_squared, factor))


@compiled
def _write_chords(
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
def _write_bend(
    squared_length: np.ndarray, before: np.ndarray, after: np.ndarray, per_squared: np.ndarray, factor: np.ndarray
) -> None:
    """Write what :class:`Bend` needs of each chord: one over its squared length, and its factor."""
    for pair in range(len(before)):
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
def _add_height(
    turn: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    per_squared: np.ndarray,
    factor: np.ndarray,
    right: np.ndarray,
) -> None:
    """Add the height of each chord's bend, for how much the normal turns along each."""
    for pair in range(len(right)):
        if factor[pair] != 0:
            one, other = before[pair], after[pair]
            right[pair] += factor[pair] * (turn[other] * per_squared[other] - turn[one] * per_squared[one])


@compiled
def _write_residual(
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
def _write_variance(
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


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """By how much chords leave their mean tangent planes where the curvature changes along them: h³ κ' / 12.

    It is what the trapezium leaves out (Euler and Maclaurin), zero on planes and spheres. κ' comes from the chords ``before`` and
    ``after``; where one is missing, nothing is put right.
    """

    before: Int32[np.ndarray, " pairs"]
    after: Int32[np.ndarray, " pairs"]
    per_squared: SmallPerPair
    factor: SmallPerPair


def _smallest_variance(rays: Rays) -> float:
    known = rays.precision > 0
    return SMALLEST_CHORD_SHARE**2 / float(np.median(rays.precision[known])) if known.any() else 1.0
