"""The light paths of a mask's pixels, and the equation that a normal writes down for each pair of neighbours."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32

from recon.surface.neighbours import Neighbours, pairs_beyond

VectorMap = Float64[np.ndarray, "rows cols 3"]
ScalarMap = Float64[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]
PerPair = Float64[np.ndarray, " pairs"]
PerPixel = Float64[np.ndarray, " pixels"]

# Chords are never trusted more than this share of a distance's sd: beyond it double precision ends, and an error of a
# chord adds up over a thousand pixels to only 30 times as much.
SMALLEST_CHORD_SHARE = 1e-4
# A normal of which nothing is known still points into the liquid: about so far from the middle of a hemisphere. A pixel
# with such a normal stays tied to its neighbours.
LARGEST_NORMAL_SD_RAD = 1.0


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
    variance: PerPair
    chord_mm: Float64[np.ndarray, "pairs 3"]
    bend: "Bend"

    def residual(self, graph: Neighbours, distance: PerPixel) -> PerPair:
        """Return by how much each chord leaves its tangent plane, in mm."""
        return self.at_first * distance[graph.first] + self.at_second * distance[graph.second] - self.right


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


def chords_of(rays: Rays, graph: Neighbours, distance: PerPixel) -> Chords:
    """Write down every pair's equation and its variance, for a surface near ``distance``."""
    first, second = graph.first, graph.second
    mean = rays.normal[first] + rays.normal[second]
    mean *= (1 / np.maximum(np.sqrt(_dot(mean, mean)), np.finfo(float).tiny))[:, None]
    along_first, along_second = rays.direction[first], rays.direction[second]
    between = rays.origin[second] - rays.origin[first]
    # The chord without the noise of the distances: go from ray to ray at the mean distance, then along the ray onto
    # the tangent plane.
    chord_mm = between + (0.5 * (distance[first] + distance[second]))[:, None] * (along_second - along_first)
    at_first, at_second = -_dot(mean, along_first), _dot(mean, along_second)
    slope = 0.5 * (at_second - at_first)
    slope = np.where(np.abs(slope) > 1e-6, slope, 1e-6)
    chord_mm -= (0.5 * _dot(mean, chord_mm) / slope)[:, None] * (along_first + along_second)
    squared_length = _dot(chord_mm, chord_mm)
    if len(squared_length):
        # Two pixels that share a ray are as far apart as rounding says.
        squared_length = np.maximum(squared_length, 1e-6 * np.median(squared_length))
    # A normal serves both pairs on its line, so that along a line its error adds up whole: one tilt's variance a pixel.
    tilt_variance = 0.5 * (rays.tilt_variance[first] + rays.tilt_variance[second])
    bend = Bend.of(chord_mm, graph)
    turn = rays.normal[second] - rays.normal[first]
    return Chords(
        at_first=at_first,
        at_second=at_second,
        right=bend.height_mm(_dot(turn, chord_mm)) - _dot(mean, between),
        variance=np.maximum(squared_length * tilt_variance, _smallest_variance(rays)),
        chord_mm=chord_mm,
        bend=bend,
    )


def _dot(first: Float64[np.ndarray, "pairs 3"], second: Float64[np.ndarray, "pairs 3"]) -> PerPair:
    return np.einsum("pi,pi->p", first, second)


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """By how much chords leave their mean tangent planes where the curvature changes along them: h³ κ' / 12.

    It is what the trapezium leaves out (Euler and Maclaurin), zero on planes and spheres. κ' comes from the chords ``before`` and
    ``after``; where one is missing, nothing is put right.
    """

    before: Int32[np.ndarray, " pairs"]
    after: Int32[np.ndarray, " pairs"]
    per_squared: PerPair
    factor: PerPair

    @classmethod
    def of(cls, chord_mm: Float64[np.ndarray, "pairs 3"], graph: Neighbours) -> "Bend":
        """Prepare for the chords' lengths, on whatever normals."""
        squared = np.maximum(_dot(chord_mm, chord_mm), np.finfo(float).tiny)
        length = np.sqrt(squared)
        before, after = pairs_beyond(graph)
        apart = length + 0.5 * (length[before] + length[after])
        # On a steep rim chords grow fast, and a curvature far away says little of this one.
        alike = (before >= 0) & (after >= 0) & (apart < 4 * length)
        return cls(before, after, 1 / squared, np.where(alike, squared * length / (12 * apart), 0.0))

    def height_mm(self, turn_along_mm: PerPair) -> PerPair:
        """Return it for the change of the normal from each chord's first to its second end, along the chord."""
        curvature = turn_along_mm * self.per_squared
        return self.factor * (curvature[self.after] - curvature[self.before])


def _smallest_variance(rays: Rays) -> float:
    known = rays.precision > 0
    return SMALLEST_CHORD_SHARE**2 / float(np.median(rays.precision[known])) if known.any() else 1.0
