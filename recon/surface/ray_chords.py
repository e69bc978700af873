"""The light paths of a mask's pixels, and the equation that a normal writes down for each pair of neighbours."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from recon.bands import over_bands
from recon.surface import chord_loops
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

    def measured_anew(self, distance_mm: ScalarMap, distance_sd_mm: ScalarMap, used: Mask) -> "Rays":
        """Return the same rays with other distances measured on them."""
        measured_mm, precision = _measured(distance_mm, distance_sd_mm, used)
        return replace(self, measured_mm=measured_mm, precision=precision)


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
        chord_loops.write_residual(graph.first, graph.second, self.at_first, self.at_second, self.right, distance, left)
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
    measured_mm, precision = _measured(distance_mm, distance_sd_mm, used)
    return Rays(
        origin=origin_mm[used],
        direction=direction[used],
        measured_mm=measured_mm,
        precision=precision,
        normal=normal[used],
        tilt_variance=np.minimum(normal_sd_rad[used], LARGEST_NORMAL_SD_RAD) ** 2 / 2,
    )


def _measured(distance_mm: ScalarMap, distance_sd_mm: ScalarMap, used: Mask) -> tuple[PerPixel, PerPixel]:
    """Return the distances of the used pixels and one over their variances, 0 where nothing was measured."""
    measured = measured_pixels(distance_mm, distance_sd_mm)[used]
    variance = np.where(measured, distance_sd_mm[used], np.inf) ** 2
    return np.where(measured, distance_mm[used], 0.0), 1 / variance


def chords_of(
    rays: Rays,
    graph: Neighbours,
    beyond: tuple[Int32[np.ndarray, " pairs"], Int32[np.ndarray, " pairs"]],
    distance: PerPixel,
    *,
    threads: int = 1,
) -> Chords:
    """Write down every pair's equation and its variance, for a surface near ``distance``.

    ``beyond`` are the pairs before and after each, as :func:`~recon.surface.neighbours.pairs_beyond` tells them. So many
    ``threads`` share the pairs.
    """
    pairs = len(graph.first)
    at_first, at_second, right, turn = (np.empty(pairs) for _ in range(4))
    variance, per_squared, factor = (np.empty(pairs, np.float32) for _ in range(3))
    chord_mm = np.empty((pairs, 3), np.float32)
    squared_length = np.empty(pairs, np.float32)
    ends = (graph.first, graph.second)

    def write(band: slice) -> None:
        some = (graph.first[band], graph.second[band])
        found = (at_first[band], at_second[band], right[band], turn[band], chord_mm[band])
        chord_loops.write_chords(*some, rays.origin, rays.direction, rays.normal, distance, *found)
        squared_length[band] = np.einsum("pi,pi->p", chord_mm[band], chord_mm[band])

    def bend(band: slice) -> None:
        chord_loops.write_bend(squared_length, *beyond, band.start, band.stop, per_squared, factor)

    def rise(band: slice) -> None:
        chord_loops.add_height(turn, *beyond, per_squared, factor, band.start, band.stop, right)

    for work in (write, bend, rise):
        over_bands(work, pairs, threads=threads)
    # Two pixels that share a ray are as far apart as rounding says.
    least = 1e-6 * float(np.median(squared_length)) if pairs else 0.0
    chord_loops.write_variance(*ends, squared_length, rays.tilt_variance, least, _smallest_variance(rays), variance)
    return Chords(at_first, at_second, right, variance, chord_mm, Bend(*beyond, per_squared, factor))


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
