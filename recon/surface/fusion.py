"""Positions and normals together, on the rays themselves.

Each pixel's point lies on one of its light paths, X_k = O_k + t_k V_k. Two neighbours with mean normal n give the
equation n·(X_j − X_i) = 0, which is exact on planes and spheres, with the noise of the normals; the crossing of the two
light paths gives t_k itself, with its own noise. Both together are one sparse positive definite system. The rays carry
the lateral noise of the correspondences, but a chord between the places where the *measured* rays meet the surface is
still tangential, so that noise does not enter.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float16, Float32, Float64

from recon.memory import give_back_free_memory
from recon.surface.error_draws import (
    DRAW_TOLERANCE,
    DRAWS,
    TURN_WINDOW_PX,
    NoiseAt,
    drawn_errors,
    standard_deviation,
)
from recon.surface.fusion_rounds import Remeasure, solve_in_rounds
from recon.surface.neighbours import neighbours_of, parts_of
from recon.surface.ray_chords import Mask, ScalarMap, VectorMap, measured_pixels
from recon.surface.sparse_solver import block_solver

ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class FusedSurface:
    """The fused surface: distance along each ray with its sd, point there, and what say each measurement kept.

    ``position_weight`` is 1 where the triangulated distance agrees with the surface and falls towards 0 for an outlier
    (0 where there was none); ``outlier`` marks pixels that agree with none about them. ``normal_scale`` and ``position_scale``
    tell how many times larger the residuals are than the standard deviations promised (never below 1). ``distance_error_mm``
    holds draws of the error of ``distance_mm``: what independent draws of all measurements' noise do to it. Their mean square is
    the variance. ``slide_mm`` tells how far each path then meets the surface from where it should, along the first two axes of
    ``sight_frame``, whose third is the mean line of sight; ``own_turn_rad`` by how much each pixel's measured normal is then
    off that of the place where the pixel looks; ``turn_sd_rad`` how large the errors of normals were that went in.
    """

    distance_mm: ScalarMap
    distance_sd_mm: ScalarMap
    distance_error_mm: Float32[np.ndarray, "draws rows cols"]
    slide_mm: Float16[np.ndarray, "2 draws rows cols"]
    sight_frame: Float64[np.ndarray, "3 3"]
    own_turn_rad: Float16[np.ndarray, "3 draws rows cols"]
    turn_sd_rad: ScalarMap
    point_mm: VectorMap
    position_weight: ScalarMap
    outlier: Mask
    normal_scale: float
    position_scale: float


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
        Share the equations, the coarser systems and the draws of the noise; the result is the same whatever their number.

    Returns
    -------
    FusedSurface
        NaN outside the mask and in connected parts that hold no triangulated distance at all.
    """
    used = _usable(mask, origin_mm, direction, normal, normal_sd_rad, distance_mm, distance_sd_mm)
    graph = neighbours_of(used)
    maps = (origin_mm, direction, distance_mm, distance_sd_mm, normal, normal_sd_rad)
    solved = solve_in_rounds(graph, maps, remeasure, noise, rounds=rounds, threads=threads)
    distance_map = graph.on_grid(solved.distance)
    point = origin_mm + distance_map[..., None] * direction
    # What was measured is not asked for again, and nobody else may hold it: the draws need that room.
    del maps, origin_mm, distance_mm, distance_sd_mm, normal_sd_rad
    give_back_free_memory()
    turn = np.full(used.shape, np.nan)
    if graph.pixels:
        errors, slides, own_turns, turned_squared = drawn_errors(
            graph,
            solved.chords,
            solved.pulls,
            partial(block_solver, solved.system.matrix, relative_tolerance=DRAW_TOLERANCE),
            solved.noise,
            across=solved.sight_frame[:2],
            weights=(solved.system.chord_weight, solved.system.own_weight),
            scales=(solved.position_scale, solved.normal_scale),
            threads=threads,
        )
        turn[used] = np.sqrt(turned_squared)
    else:
        errors, slides, own_turns = (
            np.full((DRAWS, *used.shape), np.nan, np.float32),
            np.zeros((2, DRAWS, *used.shape), np.float16),
            np.zeros((3, DRAWS, *used.shape), np.float16),
        )
    outlier = np.zeros(used.shape, dtype=bool)
    outlier[used] = solved.outlier
    return FusedSurface(
        distance_mm=distance_map,
        distance_sd_mm=standard_deviation(errors, used),
        distance_error_mm=errors,
        slide_mm=slides,
        sight_frame=solved.sight_frame,
        own_turn_rad=own_turns,
        turn_sd_rad=standard_deviation(turn[None], used, window_px=TURN_WINDOW_PX),
        point_mm=point,
        position_weight=graph.on_grid(solved.position_weight),
        outlier=outlier,
        normal_scale=solved.normal_scale,
        position_scale=solved.position_scale,
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
