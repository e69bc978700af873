"""The equations of a fused surface, weighted anew and solved in rounds, with the distances read anew in between."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float64
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from recon.bands import side_by_side
from recon.memory import give_back_free_memory
from recon.surface.error_draws import NoiseAt, NoiseDraw, independent_noise
from recon.surface.lateral_places import frame_along
from recon.surface.neighbours import Neighbours, normal_equations, pairs_beyond
from recon.surface.ray_chords import (
    Chords,
    PerPair,
    PerPixel,
    Rays,
    ScalarMap,
    VectorMap,
    chords_of,
    measured_pixels,
    rays_of,
)
from recon.surface.sheets import NORMAL_CONSISTENT_MAD, Sheets, contradiction, sheets_of, with_long_jumps
from recon.surface.sparse_solver import solver
from recon.surface.steady_pulls import Pulls

# Geman and McClure's loss (1987) with this width keeps 95 % of the efficiency of least squares for Gaussian noise.
LOSS_WIDTH_SD = 3.787
# What a measurement that stands against all others still counts, so that a part where all do stays where they are.
LEAST_WEIGHT = 1e-9
START_WINDOW_PX = 5
# A measured distance that far from the median about it is a surface that bends, not noise.
START_SD = 3.0
# So many of its own sd may the mean over any pixels, or what else is made of them, be off. What a round leaves, the next mends.
ERROR_SD, ROUND_ERROR_SD = 0.05, 1.0
# Reads the measured distances and their standard deviations again, for a surface near the distances given.
Remeasure = Callable[[ScalarMap], tuple[ScalarMap, ScalarMap]]


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """What each measurement still counts, 0 to 1, and the factor by which their standard deviations were too small."""

    weight: np.ndarray
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """The normal equations of one round: matrix, and the weight (1 / variance) of every chord and measured distance."""

    matrix: csr_array
    chord_weight: np.ndarray
    own_weight: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The distances after all rounds, with the equations that their errors obey and the noise of what was measured."""

    distance: PerPixel
    chords: Chords
    pulls: Pulls
    system: System
    noise: NoiseDraw
    sight_frame: Float64[np.ndarray, "3 3"]
    outlier: np.ndarray
    position_weight: np.ndarray
    normal_scale: float
    position_scale: float


def solve_in_rounds(
    graph: Neighbours,
    maps: tuple[VectorMap, VectorMap, ScalarMap, ScalarMap, VectorMap, ScalarMap],
    remeasure: Remeasure | None,
    noise: NoiseAt | None,
    *,
    rounds: int,
    threads: int,
) -> Solved:
    """Weigh and solve the equations, a round at a time; ``maps`` are those of :func:`~recon.surface.fusion.fuse_on_rays`."""
    _, direction, distance_mm, distance_sd_mm, normal, normal_sd_rad = maps
    beyond, rays = side_by_side(partial(pairs_beyond, graph), partial(rays_of, *maps, graph.mask), threads=threads)

    def begin() -> tuple[Sheets, PerPixel]:
        sheets = sheets_of(chords_of(rays, graph, beyond, rays.measured_mm, threads=threads), graph, rays)
        return sheets, _first_guess(rays, graph, sheets)

    (sheets, distance), pulls = side_by_side(
        begin, partial(Pulls.of, graph, direction, normal, normal_sd_rad), threads=threads
    )
    chords = chords_of(rays, graph, beyond, distance, threads=threads)
    pairs = _cut(_reweighted(contradiction(chords, graph, rays, distance)), sheets)
    positions = _position_weights(rays, distance)
    for number in range(rounds if graph.pixels else 0):
        distance = _solve(
            graph,
            rays,
            chords,
            pulls,
            _system(graph, rays, chords, pulls, pairs, positions),
            distance,
            error_sd=ERROR_SD if number == rounds - 1 else ROUND_ERROR_SD,
            threads=threads,
        )
        del chords, pairs, positions
        if remeasure is not None:
            told_mm, told_sd_mm = remeasure(graph.on_grid(distance))
            told = measured_pixels(told_mm, told_sd_mm)
            told_mm, told_sd_mm = np.where(told, told_mm, distance_mm), np.where(told, told_sd_mm, distance_sd_mm)
            rays = rays.measured_anew(told_mm, told_sd_mm, graph.mask)
        if number == 0:
            sheets = with_long_jumps(sheets, graph, rays, distance, threads=threads)
        chords = chords_of(rays, graph, beyond, distance, threads=threads)
        pairs, positions = side_by_side(
            partial(_pair_weights, chords, graph, distance, sheets),
            partial(_position_weights, rays, distance),
            threads=threads,
        )
        give_back_free_memory()
    sight = rays.direction.sum(axis=0) if graph.pixels else np.array([0.0, 0.0, 1.0])
    return Solved(
        distance=distance,
        chords=chords,
        pulls=pulls,
        system=_system(graph, rays, chords, pulls, pairs, positions),
        noise=independent_noise(rays) if noise is None else noise(graph.on_grid(distance), graph.mask),
        sight_frame=frame_along(sight / np.linalg.norm(sight)),
        outlier=sheets.outlier,
        position_weight=positions.weight,
        normal_scale=pairs.scale,
        position_scale=positions.scale,
    )


def _first_guess(rays: Rays, graph: Neighbours, sheets: Sheets) -> PerPixel:
    """Return a distance for every pixel: a running median where it agrees with the measured one, else that one.

    Outliers and pixels without a distance take the nearest one of the others, so that they do not pull in the first round.
    """
    sound = (rays.precision > 0) & ~sheets.outlier
    if not sound.any():
        sound = rays.precision > 0
    measured = graph.on_grid(np.where(sound, rays.measured_mm, np.nan))
    nearest = distance_transform_edt(np.isnan(measured), return_distances=False, return_indices=True)
    filled = measured[tuple(nearest)]
    median = cv2.medianBlur(filled.astype(np.float32), START_WINDOW_PX)[graph.mask].astype(np.float64)
    bends = np.abs(median - rays.measured_mm) * np.sqrt(rays.precision) > START_SD
    return np.where(sound & bends, rays.measured_mm, median)


def _system(
    graph: Neighbours, rays: Rays, chords: Chords, pulls: Pulls, pairs: _Weights, positions: _Weights
) -> System:
    weight = pairs.weight / (pairs.scale**2 * chords.variance)
    own = positions.weight * rays.precision / positions.scale**2
    return System(normal_equations(graph, pulls.at_first, pulls.at_second, weight, own), weight, own)


def _gather(graph: Neighbours, pulls: Pulls, per_chord: PerPair, per_pixel: PerPixel) -> PerPixel:
    """Return Jᵀ applied to one value a chord and one a measured distance."""
    total = per_pixel + np.bincount(graph.first, pulls.at_first * per_chord, minlength=graph.pixels)
    return total + np.bincount(graph.second, pulls.at_second * per_chord, minlength=graph.pixels)


def _solve(
    graph: Neighbours,
    rays: Rays,
    chords: Chords,
    pulls: Pulls,
    system: System,
    guess: PerPixel,
    *,
    error_sd: float,
    threads: int,
) -> PerPixel:
    """Correct ``guess`` towards where the pulls of chords and measured distances, each by its weight, cancel.

    With exact factors that is the least Σ weight · residual² / variance.
    """
    chord_pull = -system.chord_weight * chords.residual(graph, guess)
    right = _gather(graph, pulls, chord_pull, system.own_weight * (rays.measured_mm - guess))
    # Weights change by decades where a measurement is found to be wrong: a multigrid of the last round's would not see it.
    solve = solver(system.matrix, error_sd=error_sd, threads=threads)
    return guess + solve(right, np.zeros_like(guess))


def _pair_weights(chords: Chords, graph: Neighbours, distance: PerPixel, sheets: Sheets) -> _Weights:
    """Weigh the chords by their agreement with ``distance``."""
    return _cut(_reweighted(chords.residual(graph, distance) / np.sqrt(chords.variance)), sheets)


def _cut(pairs: _Weights, sheets: Sheets) -> _Weights:
    """Cut the pairs across which the depth jumps."""
    return _Weights(np.where(sheets.jump, 0.0, pairs.weight), pairs.scale)


def _position_weights(rays: Rays, distance: PerPixel) -> _Weights:
    """Weigh the measured distances by their agreement with ``distance``; 0 where there is none."""
    known = rays.precision > 0
    weights = _reweighted((distance - rays.measured_mm)[known] * np.sqrt(rays.precision[known]))
    everywhere = np.zeros(len(distance))
    everywhere[known] = weights.weight
    return _Weights(everywhere, weights.scale)


def _reweighted(normalised: np.ndarray) -> _Weights:
    """Return the weights of residuals given in standard deviations, and the factor by which these were too small."""
    if not len(normalised):
        return _Weights(np.ones(0), 1.0)
    scale = max(1.0, NORMAL_CONSISTENT_MAD * float(np.median(np.abs(normalised))))
    weight = (1 + (normalised / (LOSS_WIDTH_SD * scale)) ** 2) ** -2
    return _Weights(np.maximum(weight, LEAST_WEIGHT), scale)
