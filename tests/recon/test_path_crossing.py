"""Crossings read without favour, and the bend of a surface: against closed forms and draws of known noise."""

import numpy as np
import pytest
from known_surface import RADIUS_MM, sphere
from test_crossing import bundle, paths_through

from recon.geometry.entry_point import entry_points
from recon.surface.curvature import curvature_of
from recon.surface.path_crossing import PathCrossing


def test_noisy_crossings_are_right_on_the_mean_and_scatter_as_they_say() -> None:
    rng = np.random.default_rng(5)
    shape = (60, 60)
    pixels = np.arange(3600)
    point, first, second = (np.repeat(a[:1], 3600, axis=0) for a in bundle(1, rng))
    # The paths cross at 4.7°, which the noise of the four display points lets scatter by 0.9°.
    sd_mm = 0.08
    liquid, air = paths_through(point, first, sd_mm, rng), paths_through(point, second, sd_mm, rng)
    points = entry_points(liquid, air, weighted=True)
    reading = PathCrossing.of(liquid, air, points, pixels=pixels, used=pixels >= 0, shape=shape)
    true_mm = ((point - liquid.near_mm) * liquid.direction).sum(axis=1)
    told_mm, told_sd_mm = reading.measured_near(true_mm)
    error = told_mm - true_mm
    assert error.mean() == pytest.approx(0, abs=4 * error.std() / 60)
    # 3,600 draws tell a sd to 1.2 %; the mean angle over 80 pixels is known to 2 %.
    assert np.sqrt(np.mean((error / told_sd_mm) ** 2)) == pytest.approx(1, abs=0.08)
    # Crossed one by one and weighed by their own angles, they lie too near by more than that.
    alone = np.average(points.distance_liquid_mm - true_mm, weights=points.angle_rad**2)
    assert alone < -4 * error.std() / 60
    assert reading.readable(angle_sigma=10.0).all()


def test_ball_bends_alike_in_every_direction_along_it() -> None:
    scene = sphere(61)
    inner = scene.mask & (np.hypot(scene.point[..., 0], scene.point[..., 1]) < 14)
    bend = curvature_of(scene.point, scene.normal, scene.mask)
    along = np.eye(3) - scene.normal[..., :, None] * scene.normal[..., None, :]
    assert np.abs(bend - along / RADIUS_MM)[inner].max() < 0.02 / RADIUS_MM


def test_bend_at_a_rim_is_that_of_the_rim_and_not_of_the_middle_of_its_window() -> None:
    x, y = np.meshgrid(np.arange(4.0, 10.25, 0.5), np.arange(0.0, 10.25, 0.5))
    # z = x³/1000, whose curvature is z'' / (1 + z'²)^1.5; two pixels farther in it is less by a twelfth.
    slope, bend = 3e-3 * x**2, 6e-3 * x
    point = np.stack([x, y, 1e-3 * x**3], axis=2)
    normal = np.stack([-slope, 0 * x, np.ones_like(x)], axis=2) / np.sqrt(1 + slope**2)[..., None]
    true = -bend / (1 + slope**2) ** 1.5
    found = np.trace(curvature_of(point, normal, np.ones(x.shape, dtype=bool)), axis1=2, axis2=3)
    assert abs(true[10, -3] / true[10, -1] - 1) > 0.04
    assert found[10, -3:] == pytest.approx(true[10, -3:], rel=0.02)


def test_lone_pixel_shows_no_bend() -> None:
    scene = sphere(61)
    scene.mask[:25, :25] = False
    scene.mask[14, 14] = True
    assert np.abs(curvature_of(scene.point, scene.normal, scene.mask)[14, 14]).max() < 1e-9 / RADIUS_MM
