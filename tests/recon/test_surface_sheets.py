"""Creases, steps, holes and outliers on planes: what the data say stays, and what stands against all others does not pull."""

import numpy as np
from known_surface import DISTANCE_MM, Scene, plane, rms, sphere

from recon.evaluation.spread import angle_between_rad
from recon.surface.fusion import FusedSurface
from recon.surface.long_jumps import long_jumps
from recon.surface.refinement import RefinedSurface, refine_surface

SD_MM, NORMAL_SD_RAD = 0.05, 0.004


def roof(size: int = 32, slope: float = 0.4) -> Scene:
    """Two planes that meet in a crease along the column in the middle."""
    scene = plane(size)
    side = np.sign(scene.point[..., 0])
    scene.point[..., 2] = -slope * np.abs(scene.point[..., 0])
    scene.normal[...] = np.stack([slope * side, np.zeros_like(side), np.ones_like(side)], axis=2) / np.hypot(slope, 1)
    return scene


def surfaces(scene: Scene, error_mm: np.ndarray, *, seed: int) -> tuple[FusedSurface, RefinedSurface, np.ndarray]:
    """Return the fused surface, the refined one and the measured normals, for one draw of noise and a given gross error."""
    distance, normal = scene.noisy(seed, SD_MM, NORMAL_SD_RAD)
    fused = scene.fuse(distance + error_mm, SD_MM, normal, NORMAL_SD_RAD)
    ones = np.ones(scene.mask.shape)
    covariance = np.broadcast_to(SD_MM**2 * np.eye(3), (*scene.mask.shape, 3, 3))
    return fused, refine_surface(fused, scene.direction, normal, NORMAL_SD_RAD * ones, covariance), normal


def test_crease_keeps_its_height_and_the_normals_of_both_its_sides() -> None:
    scene = roof()
    fused, refined, measured = surfaces(scene, np.zeros(scene.mask.shape), seed=1)
    assert rms(fused.distance_mm - DISTANCE_MM) < SD_MM / 3
    before, after = (
        angle_between_rad(each[scene.mask], scene.normal[scene.mask]) for each in (measured, refined.normal)
    )
    # The planes differ by 44°: a normal made of both sides would be off by more than any noise. 5 sd.
    assert after.max() < 5 * NORMAL_SD_RAD
    away = (np.abs(scene.point[..., 0]) > 6)[scene.mask]
    assert rms(after[away]) < rms(before[away]) / 1.5


def test_two_percent_of_outliers_neither_pull_nor_stay() -> None:
    scene = plane(24)
    rng = np.random.default_rng(2)
    wrong = rng.random(scene.mask.shape) < 0.02
    assert wrong.sum() > 8
    fused, refined, _ = surfaces(scene, wrong * rng.uniform(1, 60, wrong.shape), seed=3)
    # 576 distances and rigid normals: far below the sd of one distance.
    assert np.abs(fused.distance_mm - DISTANCE_MM).max() < SD_MM
    assert (fused.position_weight[wrong] < 1e-6).all()
    np.testing.assert_array_equal(fused.outlier, wrong)
    assert np.abs(refined.point_mm[..., 2]).max() < SD_MM


def test_pixels_between_outliers_at_the_rim_keep_to_the_sheet_that_most_are_on() -> None:
    scene = plane(12)
    scene.mask[:3] = False
    scene.mask[2, 4:6] = True
    scene.mask[1, 4] = True
    error = np.zeros(scene.mask.shape)
    error[2, 4], error[1, 4] = 58.0, 57.0
    fused, _, _ = surfaces(scene, error, seed=4)
    assert np.abs(fused.distance_mm - DISTANCE_MM)[2:, :][scene.mask[2:]].max() < 3 * SD_MM


def test_a_row_along_the_rim_that_stands_against_all_others_is_no_sheet() -> None:
    scene = plane(20)
    scene.mask[0] = False
    row = np.zeros(scene.mask.shape, bool)
    row[1, 3:16] = True
    fused, _, _ = surfaces(scene, np.where(row, 20.0, 0.0), seed=7)
    np.testing.assert_array_equal(fused.outlier, row)


def test_step_is_cut_where_both_sides_say_so() -> None:
    scene = plane(20)
    step = np.zeros(scene.mask.shape)
    step[:, 10:] = 1.0  # 14 sd of the difference of two distances
    fused, refined, _ = surfaces(scene, step, seed=5)
    assert np.abs(fused.distance_mm - DISTANCE_MM - step).max() < SD_MM
    assert np.abs(-refined.point_mm[..., 2] - step).max() < SD_MM


def test_a_step_that_no_pair_shows_is_cut_where_all_along_it_say_so() -> None:
    scene = plane(40)
    # Askew to the pixels; 2.8 sd of the difference of two distances.
    step = 0.2 * (np.arange(40) > 18 + 0.1 * np.arange(40)[:, None])
    fused, refined, _ = surfaces(scene, step, seed=8)
    # Hundreds of distances on each side tell its level to a tenth of the step, and a pixel beside the edge is on either side.
    beside = np.abs(np.arange(40) - 18.5 - 0.1 * np.arange(40)[:, None]) < 1
    for found in (fused.distance_mm - DISTANCE_MM, -refined.point_mm[..., 2]):
        assert np.abs(found - step)[~beside].max() < SD_MM / 2


def test_noise_on_a_sphere_parts_nothing() -> None:
    scene = sphere(61)
    distance, _ = scene.noisy(9, SD_MM, NORMAL_SD_RAD)
    left_mm = np.where(scene.mask, distance - DISTANCE_MM, 0.0)
    right, below = long_jumps(left_mm, np.where(scene.mask, 1 / SD_MM**2, 0.0))
    assert not right.any()
    assert not below.any()


def test_hole_is_bridged_by_normals_alone_with_a_wider_standard_deviation() -> None:
    scene = plane(24)
    hole = np.zeros(scene.mask.shape, bool)
    hole[8:16, 8:16] = True
    fused, _, _ = surfaces(scene, np.where(hole, np.nan, 0.0), seed=6)
    assert np.abs(fused.distance_mm - DISTANCE_MM)[hole].max() < SD_MM
    assert np.median(fused.distance_sd_mm[hole]) > np.median(fused.distance_sd_mm[~hole])
