"""Normals to depth across jumps: bilateral weights decide on which side of a pixel the surface goes on.

Cao, Santo, Shi, Okura, Matsushita: *Bilateral Normal Integration* (ECCV 2022). Each pixel's own normal is at right angles to the
chords to both its neighbours on a line, but where depth jumps to one side, only to the other. Of the two, the chord along which
depth changes less counts more: w⁺ = σ(k ((c ∂⁻z)² − (c ∂⁺z)²)), w⁻ = 1 − w⁺, with depth z in units of a pixel, c the cosine
between normal and sight, σ the logistic function, k = 2. Weights follow from depth and depth from weights, in turn.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.special import expit

from recon.surface.neighbours import Neighbours, components, neighbours_of
from recon.surface.quadratic_integration import GRAZING_COSINE, on_grids
from recon.surface.ray_bundle import Mask, PixelRays, RayBundle
from recon.surface.sparse_solver import SparseSolver
from recon.surface.steps import heights_from_steps

# The published sharpness of the choice, and when to stop: the energy changes by less than this share of itself.
SHARPNESS = 2.0
ENERGY_TOLERANCE = 1e-4
MOST_ROUNDS = 100
# The published code leaves this to its user, and its time hangs on it. A round's solution is only the next one's start.
SOLVER_TOLERANCE = 1e-5
# A chord that is given up still says where the part beyond it lies, if nothing else does.
LEAST_WEIGHT = 1e-9

PerPair = Float64[np.ndarray, " pairs"]
Vectors = Float64[np.ndarray, "pixels 3"]


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """What the pixels at one end of all pairs say: the step from first to second, and the cosine; no say where not ``good``."""

    step: PerPair
    cosine: PerPair
    good: Bool[np.ndarray, " pairs"]

    @classmethod
    def of(cls, sights: PixelRays, normal: Vectors, graph: Neighbours, own: np.ndarray) -> "_Side":
        normals = normal[own]
        at_first, at_second = sights.facing(normals, graph.first), sights.facing(normals, graph.second)
        facing = np.minimum(np.abs(at_first), np.abs(at_second))
        good = (facing > GRAZING_COSINE) & (at_first * at_second > 0)
        step = sights.step(normals, graph.first, graph.second)
        return cls(np.where(good, step, 0.0), np.where(good, facing, 0.0), good)


def integrate_bilateral(
    normal: Vectors, rays: RayBundle, used: Mask
) -> tuple[Float64[np.ndarray, "rows cols"], np.ndarray]:
    """Return the unknown of each used pixel up to a constant a part, and the number of its part; NaN and −1 elsewhere."""
    graph = neighbours_of(used)
    sights = rays.of(used)
    forward = _Side.of(sights, normal, graph, graph.first)
    backward = _Side.of(sights, normal, graph, graph.second)
    kept = forward.good | backward.good
    graph = Neighbours(used, graph.first[kept], graph.second[kept])
    forward, backward = (_Side(side.step[kept], side.cosine[kept], side.good[kept]) for side in (forward, backward))
    along_row = _along_row(graph)
    unknown = np.zeros(graph.pixels)
    spacing = rays.spacing(used)
    energy, system = np.inf, SparseSolver()
    for _ in range(MOST_ROUNDS if len(graph.first) else 0):
        ahead, behind = _weights(unknown, graph, forward, backward, along_row, spacing=spacing)
        total = ahead + behind
        step = (ahead * forward.step + behind * backward.step) / total
        unknown = heights_from_steps(
            graph, step, total, guess=unknown, relative_tolerance=SOLVER_TOLERANCE, system=system
        )
        rise = unknown[graph.second] - unknown[graph.first]
        before, energy = (
            energy,
            float((ahead * (rise - forward.step) ** 2 + behind * (rise - backward.step) ** 2).sum()),
        )
        if np.isfinite(before) and abs(before - energy) <= ENERGY_TOLERANCE * before:
            break
    return on_grids(graph, unknown, components(graph.pixels, graph.first, graph.second))


def _along_row(graph: Neighbours) -> Bool[np.ndarray, " pairs"]:
    column = np.nonzero(graph.mask)[1]
    return column[graph.first] != column[graph.second]


def _weights(
    unknown: Float64[np.ndarray, " pixels"],
    graph: Neighbours,
    forward: _Side,
    backward: _Side,
    along_row: Bool[np.ndarray, " pairs"],
    *,
    spacing: float,
) -> tuple[PerPair, PerPair]:
    """Return how much each pair counts for the pixel at its first end, and for that at its second."""
    change = (unknown[graph.second] - unknown[graph.first]) / spacing
    ahead, behind = np.empty(len(change)), np.empty(len(change))
    for line in (along_row, ~along_row):
        first, second = graph.first[line], graph.second[line]
        squares = np.full((2, graph.pixels), np.nan)
        squares[0, first] = np.where(forward.good, (forward.cosine * change) ** 2, np.nan)[line]
        squares[1, second] = np.where(backward.good, (backward.cosine * change) ** 2, np.nan)[line]
        # At an end of a line there is nothing to choose between.
        onwards = np.nan_to_num(expit(SHARPNESS * (squares[1] - squares[0])), nan=0.5)
        ahead[line], behind[line] = onwards[first], 1 - onwards[second]
    return (
        np.maximum(ahead, LEAST_WEIGHT) * forward.cosine**2,
        np.maximum(behind, LEAST_WEIGHT) * backward.cosine**2,
    )
