"""Fusion of positions and normals against surfaces that are known in closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_surface import DISTANCE_MM, RADIUS_MM, Scene, plane, rms, sphere

from recon.surface.fusion import fuse_on_rays
from recon.surface.fusion_rounds import LOSS_WIDTH_SD


def test_exact_measurements_stay_as_they_are() -> None:
    for scene in (sphere(), plane(slope=0.4)):
        found = scene.fuse(np.full(scene.mask.shape, DISTANCE_MM), 0.2, scene.normal, 0.005)
        assert np.abs(found.point_mm - scene.point)[scene.mask].max() < 1e-6
        assert np.isnan(found.distance_mm[~scene.mask]).all()


def test_on_a_plane_with_perfect_normals_the_surface_is_the_mean_of_the_distances() -> None:
    scene = plane()
    distance = np.full(scene.mask.shape, DISTANCE_MM)
    distance[3::4, 3::4] += 0.1  # so few that the median, from which the weights start, stays
    found = scene.fuse(distance, 1.0, scene.normal, 1e-6, rounds=1)
    weight = np.where(distance > DISTANCE_MM, (1 + (0.1 / LOSS_WIDTH_SD) ** 2) ** -2, 1.0)
    assert np.allclose(found.distance_mm, np.average(distance, weights=weight), atol=1e-6)


def test_loss_keeps_95_percent_of_the_efficiency_of_least_squares() -> None:
    # Huber, Robust Statistics (1981), section 3.2: efficiency = (E ψ')² / E ψ² under the unit Gaussian.
    z = np.linspace(-12, 12, 200_001)
    density = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi) * (z[1] - z[0])
    influence = z * (1 + (z / LOSS_WIDTH_SD) ** 2) ** -2
    slope = (1 - 3 * (z / LOSS_WIDTH_SD) ** 2) * (1 + (z / LOSS_WIDTH_SD) ** 2) ** -3
    assert (slope @ density) ** 2 / (influence**2 @ density) == pytest.approx(0.95, abs=5e-4)


def test_error_on_a_plane_with_perfect_normals_is_that_of_a_mean() -> None:
    scene = plane()
    errors = [
        scene.fuse(scene.noisy(seed, 0.1, 0.0)[0], 0.1, scene.normal, 1e-7).distance_mm.mean() - DISTANCE_MM
        for seed in range(40)
    ]
    # The loss keeps 95 % of the efficiency; 4 sigma of the sd of 40 values, which is 1/√80 of it.
    assert rms(np.array(errors)) == pytest.approx(0.1 / 20 / np.sqrt(0.95), rel=4 / np.sqrt(80))


def test_fused_sphere_is_far_better_than_the_cloud_and_keeps_its_radius() -> None:
    scene = sphere(61)
    distance, normal = scene.noisy(2, 0.23, 0.005)
    found = scene.fuse(distance, 0.23, normal, 0.005)
    assert rms(found.distance_mm - DISTANCE_MM) < 0.23 / 10
    radius = np.linalg.norm(found.point_mm, axis=2)
    # 2,700 independent distances fix a common shift to 0.23/√2700; 4 sigma.
    assert np.nanmean(radius) == pytest.approx(RADIUS_MM, abs=4 * 0.23 / np.sqrt(scene.mask.sum()))


def test_error_falls_with_the_noise_of_either_measurement() -> None:
    scene = sphere()

    def error(sd: float, normal_sd: float) -> float:
        found = []
        for seed in range(4):
            distance, normal = scene.noisy(seed, sd, normal_sd)
            found.append(rms(scene.fuse(distance, sd, normal, normal_sd).distance_mm - DISTANCE_MM))
        return float(np.mean(found))

    assert error(0.02, 0.002) < error(0.2, 0.002) < error(0.2, 0.02) < error(0.2, 0.1)


def test_pixels_without_a_triangulated_point_are_covered() -> None:
    scene = sphere()
    distance, normal = scene.noisy(3, 0.05, 0.002)
    hole = np.zeros(scene.mask.shape, bool)
    hole[15:26, 15:26] = True
    found = scene.fuse(np.where(hole, np.nan, distance), 0.05, normal, 0.002)
    assert rms((found.distance_mm - DISTANCE_MM)[hole]) < 0.03
    assert (found.position_weight[hole] == 0).all()


def test_gross_outliers_do_not_bend_the_surface() -> None:
    scene = sphere()
    distance, normal = scene.noisy(4, 0.05, 0.002)
    rng = np.random.default_rng(9)
    wrong = rng.random(scene.mask.shape) < 0.2
    found = scene.fuse(distance + wrong * rng.uniform(3, 20, wrong.shape), 0.05, normal, 0.002)
    clean = scene.fuse(np.where(wrong, np.nan, distance), 0.05, normal, 0.002)
    assert rms(found.distance_mm - DISTANCE_MM) < 2 * rms(clean.distance_mm - DISTANCE_MM)
    assert np.nanmax(found.position_weight[wrong]) < 0.01


def test_step_of_depth_inside_the_mask_stays_a_step() -> None:
    scene = plane(30)
    step = np.zeros(scene.mask.shape)
    step[:, 15:] = 5.0
    distance, normal = scene.noisy(5, 0.1, 0.002)
    found = scene.fuse(distance + step, 0.1, normal, 0.002)
    assert rms(found.distance_mm - DISTANCE_MM - step) < 0.05


def test_standard_deviations_that_promise_too_much_are_reported() -> None:
    scene = sphere(61)
    distance, normal = scene.noisy(6, 0.3, 0.005)
    found = scene.fuse(distance, 0.1, normal, 0.005)
    assert found.position_scale == pytest.approx(3.0, rel=0.1)
    assert found.normal_scale < 1.1


def test_part_without_any_triangulated_point_is_left_out() -> None:
    scene = plane()
    scene.mask[:, 10] = False
    distance = np.full(scene.mask.shape, DISTANCE_MM)
    distance[:, 11:] = np.nan
    found = scene.fuse(distance, 0.1, scene.normal, 0.01)
    assert np.isfinite(found.distance_mm[:, :10]).all()
    assert np.isnan(found.distance_mm[:, 10:]).all()


def test_pixel_with_a_worthless_normal_is_held_by_its_neighbours() -> None:
    scene = sphere()
    distance, normal = scene.noisy(10, 0.05, 0.002)
    sd, normal_sd = np.full(scene.mask.shape, 0.05), np.full(scene.mask.shape, 0.002)
    normal[20, 20] = [0.6, 0.0, 0.8]
    normal_sd[20, 20] = np.inf
    sd[20, 20] = 1e15
    found = fuse_on_rays(scene.origin, scene.direction, distance, sd, normal, normal_sd, scene.mask)
    assert abs(found.distance_mm[20, 20] - DISTANCE_MM) < 0.3
    # Tied by four chords of about 1 mm whose normals are known to a radian or so.
    assert found.distance_sd_mm[20, 20] < 1.0


def test_standard_deviation_of_a_lone_pixel_is_that_of_its_measurement() -> None:
    scene = plane(9)
    apart = np.zeros(scene.mask.shape, bool)
    apart[::2, ::2] = True
    scene.mask &= apart
    found = scene.fuse(np.full(scene.mask.shape, DISTANCE_MM), 0.1, scene.normal, 0.01)
    # Six draws over nine pixels of a 5 × 5 window: 54 squares in the middle; 4 sigma.
    assert found.distance_sd_mm[4, 4] == pytest.approx(0.1, rel=4 / np.sqrt(2 * 54))


def test_standard_deviation_falls_as_more_pixels_agree() -> None:
    scene = plane(20)
    found = scene.fuse(np.full(scene.mask.shape, DISTANCE_MM), 0.1, scene.normal, 1e-5)
    # Rigidly joined by their normals, 400 pixels are one mean; six draws tell its sd to 29 %, 3 sigma.
    assert np.median(found.distance_sd_mm) == pytest.approx(0.1 / 20, rel=3 / np.sqrt(12))


def test_nothing_usable_gives_nothing() -> None:
    scene = plane()
    found = scene.fuse(np.full(scene.mask.shape, np.nan), 0.1, scene.normal, 0.01)
    assert np.isnan(found.point_mm).all()


@settings(max_examples=10, deadline=None)
@given(scale=st.floats(1e-2, 1e2))
def test_scaling_the_scene_scales_the_surface(scale: float) -> None:
    scene = sphere(15)
    distance, normal = scene.noisy(7, 0.2, 0.01)
    found = scene.fuse(distance, 0.2, normal, 0.01)
    ones = np.ones(scene.mask.shape)
    scaled = fuse_on_rays(
        scale * scene.origin, scene.direction, scale * distance, scale * 0.2 * ones, normal, 0.01 * ones, scene.mask
    )
    assert np.allclose(scaled.point_mm, scale * found.point_mm, atol=1e-4 * scale, equal_nan=True)


def test_transposing_the_photo_transposes_the_surface() -> None:
    scene = sphere(21)
    distance, normal = scene.noisy(8, 0.2, 0.01)
    found = scene.fuse(distance, 0.2, normal, 0.01)
    turned = Scene(*(np.swapaxes(f, 0, 1) for f in (scene.point, scene.normal, scene.direction, scene.mask)))
    again = turned.fuse(distance.T, 0.2, np.swapaxes(normal, 0, 1), 0.01)
    assert np.allclose(again.distance_mm.T, found.distance_mm, atol=1e-5, equal_nan=True)


def test_noise_of_the_normals_does_not_draw_the_level_to_where_paths_lie_closer() -> None:
    scene = plane()
    x, y = scene.point[..., 0], scene.point[..., 1]
    # Paths that come 1 % closer together a mm: normals with noise would have the level lower by 0.8 mm.
    direction = np.stack([-0.01 * x, -0.01 * y, -np.ones_like(x)], axis=2)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    closer = Scene(scene.point, scene.normal, direction, scene.mask)
    apart = []
    for seed in range(12):
        distance, normal = closer.noisy(seed, 10.0, 0.05)
        # Normals say nothing of the level, so that it is the mean of the distances.
        apart.append((closer.fuse(distance, 10.0, normal, 0.05).distance_mm - distance).mean())
    assert np.mean(apart) == pytest.approx(0, abs=4 * np.std(apart, ddof=1) / np.sqrt(12))
