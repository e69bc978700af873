"""Positions and normals together, on the rays themselves.

Each pixel's point lies on one of its light paths, X_k = O_k + t_k V_k. Two neighbours with mean normal n give the
equation n·(X_j − X_i) = 0, which is exact on planes and spheres, with the noise of the normals; the crossing of the two
light paths gives t_k itself, with its own noise. Both together are one sparse positive definite system. The rays carry
the lateral noise of the correspondences, but a chord between the places where the *measured* rays meet the surface is
still tangential, so that noise does not enter.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float32, Float64
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from recon.memory import give_back_free_memory
from recon.surface.error_draws import (
    DRAW_TOLERANCE,
    DRAWS,
    TURN_WINDOW_PX,
    NoiseAt,
    NoiseDraw,
    drawn_errors,
    independent_noise,
    standard_deviation,
)
from recon.surface.lateral_places import frame_along
from recon.surface.neighbours import Neighbours, neighbours_of, normal_equations, pairs_beyond, parts_of
from recon.surface.ray_chords import (
    Chords,
    Mask,
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
from recon.surface.sparse_solver import block_solver, solver

ROUNDS = 3
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
class FusedSurface:
    """The fused surface: distance along each ray with its sd, point there, and what say each measurement kept.

    ``position_weight`` is 1 where the triangulated distance agrees with the surface and falls towards 0 for an outlier
    (0 where there was none); ``outlier`` marks pixels that agree with none about them. ``normal_scale`` and ``position_scale``
    tell how many times larger the residuals are than the standard deviations promised (never below 1). ``distance_error_mm``
    holds draws of the error of ``distance_mm``: what independent draws of all measurements' noise do to it. Their mean square is
    the variance. ``slide_mm`` tells how far each path then meets the surface from where it should, along the first two axes of
    ``sight_frame``, whose third is the mean line of sight; ``turn_sd_rad`` how large the errors of normals were that went in.
    """

    distance_mm: ScalarMap
    distance_sd_mm: ScalarMap
    distance_error_mm: Float32[np.ndarray, "draws rows cols"]
    slide_mm: Float32[np.ndarray, "2 draws rows cols"]
    sight_frame: Float64[np.ndarray, "3 3"]
    turn_sd_rad: ScalarMap
    point_mm: VectorMap
    position_weight: ScalarMap
    outlier: Mask
    normal_scale: float
    position_scale: float


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """What each measurement still counts, 0 to 1, and the factor by which their standard deviations were too small."""

    weight: np.ndarray
    scale: float


def fuse_on_rays(
    origin_mm: VectorMap,
    direction: VectorMap,
    distance_mm: ScalarMap,
    distance_sd_mm: ScalarMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
    mask: Mask,
    *,
    remeasure: Remeasure | None = None,
    noise: NoiseAt | None = None,
    rounds: int = ROUNDS,
    threads: int = 1,
) -> FusedSurface:
    """Find the surface that best explains triangulated distances and normals at once.

    Parameters
    ----------
    origin_mm, direction
        The light path of each pixel (unit direction): the one in liquid serves better, since it is bent less, so that
        a pixel sees a smaller spot of the display and its mean stays near its centre, also close to total reflection.
    distance_mm, distance_sd_mm
        Where on it the triangulation put the point, and its standard deviation; NaN where it gave none.
    normal, normal_sd_rad
        Unit normals and the standard deviation of their direction (root of the summed variances of the two tilts).
    mask
        The pixels of the surface; those without a ray or a normal are left out.
    remeasure
        Reads distances and standard deviations anew near each round's surface; without it they stay as they are.
    noise
        Draws the errors of distances and normals together, where they come from the same correspondences; without it,
        they are independent, the two tilts of a normal alike, and the paths known.
    rounds
        How often the equations are weighted anew (iteratively reweighted least squares).
    threads
        With more than one, some draws of the noise are solved while others are drawn; the result is the same.

    Returns
    -------
    FusedSurface
        NaN outside the mask and in connected parts that hold no triangulated distance at all.
    """
    used = _usable(mask, origin_mm, direction, normal, normal_sd_rad, distance_mm, distance_sd_mm)
    graph = neighbours_of(used)
    maps = (origin_mm, direction, distance_mm, distance_sd_mm, normal, normal_sd_rad)
    solved = _solved(graph, maps, remeasure, noise, rounds=rounds)
    distance_map = graph.on_grid(solved.distance)
    point = origin_mm + distance_map[..., None] * direction
    # What was measured is not asked for again, and nobody else may hold it: the draws need that room.
    del maps, origin_mm, distance_mm, distance_sd_mm, normal_sd_rad
    give_back_free_memory()
    turn = np.full(used.shape, np.nan)
    if graph.pixels:
        errors, slides, turned_squared = drawn_errors(
            graph,
            solved.chords,
            partial(block_solver, solved.system.matrix, relative_tolerance=DRAW_TOLERANCE),
            solved.noise,
            across=solved.sight_frame[:2],
            weights=(solved.system.chord_weight, solved.system.own_weight),
            scales=(solved.position_scale, solved.normal_scale),
            threads=threads,
        )
        turn[used] = np.sqrt(turned_squared)
    else:
        errors, slides = (
            np.full((DRAWS, *used.shape), np.nan, np.float32),
            np.zeros((2, DRAWS, *used.shape), np.float32),
        )
    outlier = np.zeros(used.shape, dtype=bool)
    outlier[used] = solved.outlier
    return FusedSurface(
        distance_mm=distance_map,
        distance_sd_mm=standard_deviation(errors, used),
        distance_error_mm=errors,
        slide_mm=slides,
        sight_frame=solved.sight_frame,
        turn_sd_rad=standard_deviation(turn[None], used, window_px=TURN_WINDOW_PX),
        point_mm=point,
        position_weight=graph.on_grid(solved.position_weight),
        outlier=outlier,
        normal_scale=solved.normal_scale,
        position_scale=solved.position_scale,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """The normal equations of one round: matrix, and the weight (1 / variance) of every chord and measured distance."""

    matrix: csr_array
    chord_weight: np.ndarray
    own_weight: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """The distances after all rounds, with the equations that their errors obey and the noise of what was measured."""

    distance: PerPixel
    chords: Chords
    system: _System
    noise: NoiseDraw
    sight_frame: Float64[np.ndarray, "3 3"]
    outlier: np.ndarray
    position_weight: np.ndarray
    normal_scale: float
    position_scale: float


def _solved(
    graph: Neighbours,
    maps: tuple[VectorMap, VectorMap, ScalarMap, ScalarMap, VectorMap, ScalarMap],
    remeasure: Remeasure | None,
    noise: NoiseAt | None,
    *,
    rounds: int,
) -> _Solved:
    """Weigh and solve the equations, a round at a time; ``maps`` are those that :func:`fuse_on_rays` gets, as it does."""
    origin_mm, direction, distance_mm, distance_sd_mm, normal, normal_sd_rad = maps
    beyond = pairs_beyond(graph)
    rays = rays_of(*maps, graph.mask)
    sheets = sheets_of(chords_of(rays, graph, beyond, rays.measured_mm), graph, rays)
    distance = _first_guess(rays, graph, sheets)
    chords = chords_of(rays, graph, beyond, distance)
    pairs = _cut(_reweighted(contradiction(chords, graph, rays, distance)), sheets)
    positions = _position_weights(rays, distance)
    for number in range(rounds if graph.pixels else 0):
        distance = _solve(
            graph,
            rays,
            chords,
            _system(graph, rays, chords, pairs, positions),
            distance,
            error_sd=ERROR_SD if number == rounds - 1 else ROUND_ERROR_SD,
        )
        del chords, pairs, positions
        if remeasure is not None:
            told_mm, told_sd_mm = remeasure(graph.on_grid(distance))
            told = measured_pixels(told_mm, told_sd_mm)
            told_mm, told_sd_mm = np.where(told, told_mm, distance_mm), np.where(told, told_sd_mm, distance_sd_mm)
            rays = rays_of(origin_mm, direction, told_mm, told_sd_mm, normal, normal_sd_rad, graph.mask)
        if number == 0:
            sheets = with_long_jumps(sheets, graph, rays, distance)
        chords = chords_of(rays, graph, beyond, distance)
        pairs = _cut(_reweighted(chords.residual(graph, distance) / np.sqrt(chords.variance)), sheets)
        positions = _position_weights(rays, distance)
        give_back_free_memory()
    sight = rays.direction.sum(axis=0) if graph.pixels else np.array([0.0, 0.0, 1.0])
    return _Solved(
        distance=distance,
        chords=chords,
        system=_system(graph, rays, chords, pairs, positions),
        noise=independent_noise(rays) if noise is None else noise(graph.on_grid(distance), graph.mask),
        sight_frame=frame_along(sight / np.linalg.norm(sight)),
        outlier=sheets.outlier,
        position_weight=positions.weight,
        normal_scale=pairs.scale,
        position_scale=positions.scale,
    )


def _usable(
    mask: Mask,
    origin_mm: VectorMap,
    direction: VectorMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
    distance_mm: ScalarMap,
    distance_sd_mm: ScalarMap,
) -> Mask:
    """Return the pixels with a ray and a normal, in parts that hold at least one triangulated distance."""
    complete = [np.isfinite(field).all(axis=2) for field in (origin_mm, direction, normal)]
    used = mask & np.logical_and.reduce(complete) & (normal_sd_rad > 0)
    part = parts_of(used)
    measured = np.bincount(part, measured_pixels(distance_mm, distance_sd_mm)[used])
    result = used.copy()
    result[used] = measured[part] > 0
    return result


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


def _system(graph: Neighbours, rays: Rays, chords: Chords, pairs: _Weights, positions: _Weights) -> _System:
    weight = pairs.weight / (pairs.scale**2 * chords.variance)
    own = positions.weight * rays.precision / positions.scale**2
    return _System(normal_equations(graph, chords.at_first, chords.at_second, weight, own), weight, own)


def _gather(graph: Neighbours, chords: Chords, per_chord: PerPair, per_pixel: PerPixel) -> PerPixel:
    """Return Jᵀ applied to one value a chord and one a measured distance."""
    total = per_pixel + np.bincount(graph.first, chords.at_first * per_chord, minlength=graph.pixels)
    return total + np.bincount(graph.second, chords.at_second * per_chord, minlength=graph.pixels)


def _solve(
    graph: Neighbours,
    rays: Rays,
    chords: Chords,
    system: _System,
    guess: PerPixel,
    *,
    error_sd: float,
) -> PerPixel:
    """Minimise Σ weight · residual² / variance over chords and measured distances, by a correction to ``guess``."""
    chord_pull = -system.chord_weight * chords.residual(graph, guess)
    right = _gather(graph, chords, chord_pull, system.own_weight * (rays.measured_mm - guess))
    # Weights change by decades where a measurement is found to be wrong: a multigrid of the last round's would not see it.
    solve = solver(system.matrix, error_sd=error_sd)
    return guess + solve(right, np.zeros_like(guess))


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
