"""Fits of primitives to points whose primitive is known."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recon.errors import ReconError
from recon.evaluation.consensus import mlesac_score, ransac_score
from recon.evaluation.cylinder import Cylinder, fit_cylinder, least_squares_cylinder
from recon.evaluation.facets import facets_by_normal, fit_facets
from recon.evaluation.plane import fit_plane, least_squares_plane, ransac_plane
from recon.evaluation.sphere import fit_sphere, least_squares_sphere, robust_sphere
from recon.evaluation.spread import angle_between_rad, spread_of, unit

CENTRE_MM = np.array([3.0, -7.0, 40.0])
RADIUS_MM = 27.99


def directions(count: int, rng: np.random.Generator) -> np.ndarray:
    return unit(rng.standard_normal((count, 3)))


def hemisphere(count: int, rng: np.random.Generator, noise_mm: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    radial = directions(count, rng)
    radial[:, 2] = np.abs(radial[:, 2])
    distance = RADIUS_MM + noise_mm * rng.standard_normal(count)
    return CENTRE_MM + distance[:, None] * radial, radial


def half_cylinder(
    count: int, rng: np.random.Generator, noise_mm: float = 0.0
) -> tuple[np.ndarray, np.ndarray, Cylinder]:
    """A half of a cylinder of radius 14.18 and height 44.73, lying askew."""
    axis = unit(np.array([[0.3, 0.9, -0.1]]))[0]
    first = unit(np.cross(axis, [[0.0, 0.0, 1.0]]))[0]
    second = np.cross(axis, first)
    angle = rng.uniform(0, np.pi, count)
    radial = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    along = rng.uniform(-44.73 / 2, 44.73 / 2, count)
    distance = 14.18 + noise_mm * rng.standard_normal(count)
    return CENTRE_MM + along[:, None] * axis + distance[:, None] * radial, radial, Cylinder(CENTRE_MM, axis, 14.18)


def tilted(normal: np.ndarray, sd_rad: float, rng: np.random.Generator) -> np.ndarray:
    return unit(normal + sd_rad * rng.standard_normal(normal.shape))


def test_exact_sphere_is_found_to_rounding() -> None:
    point, normal = hemisphere(500, np.random.default_rng(1))
    fit = fit_sphere(point, normal, rng=np.random.default_rng(2))
    assert fit.sphere.radius_mm == pytest.approx(RADIUS_MM, abs=1e-9)
    assert np.allclose(fit.sphere.centre_mm, CENTRE_MM, atol=1e-9)
    assert fit.position_mm.p95 < 1e-9
    assert fit.normal_rad.p95 < 1e-9


def test_error_of_a_fitted_radius_is_what_its_normal_equations_promise() -> None:
    rng = np.random.default_rng(3)
    point, radial = hemisphere(400, rng)
    slopes = np.column_stack([radial, np.ones(len(radial))])
    promised = 0.1 * np.sqrt(np.linalg.inv(slopes.T @ slopes)[3, 3])
    found = [
        least_squares_sphere(point + 0.1 * rng.standard_normal((400, 1)) * radial).radius_mm - RADIUS_MM
        for _ in range(60)
    ]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(promised, rel=4 / np.sqrt(120))


def test_sphere_is_not_moved_by_40_percent_outliers() -> None:
    rng = np.random.default_rng(4)
    point, _ = hemisphere(3000, rng, noise_mm=0.05)
    stray = rng.random(3000) < 0.4
    point[stray] += rng.uniform(2, 30, (3000, 3))[stray]
    sphere = robust_sphere(point, rng=rng)
    assert sphere.radius_mm == pytest.approx(RADIUS_MM, abs=0.03)
    assert np.allclose(sphere.centre_mm, CENTRE_MM, atol=0.03)


def test_sphere_error_is_the_distance_to_the_centre_less_the_radius() -> None:
    rng = np.random.default_rng(5)
    point, normal = hemisphere(20_000, rng, noise_mm=0.5)
    fit = fit_sphere(point, normal, rng=rng)
    # Of a Gaussian: mean and median of the magnitude are √(2/π) and 0.6745 sd.
    assert fit.position_mm.mean == pytest.approx(0.5 * np.sqrt(2 / np.pi), rel=0.02)
    assert fit.position_mm.median == pytest.approx(0.5 * 0.6745, rel=0.02)
    assert fit.position_mm.rms == pytest.approx(0.5, rel=0.02)


def test_constant_tilt_of_normals_is_read_in_full() -> None:
    rng = np.random.default_rng(6)
    point, radial = hemisphere(1000, rng)
    across = unit(np.cross(radial, directions(1000, rng)))
    leaning = np.cos(0.1) * radial + np.sin(0.1) * across
    fit = fit_sphere(point, leaning, rng=rng)
    assert fit.normal_rad.mean == pytest.approx(0.1, abs=1e-9)
    assert fit.normal_rad.median == pytest.approx(0.1, abs=1e-9)


def test_hollow_is_judged_by_its_inward_normals_but_a_single_flip_counts() -> None:
    point, radial = hemisphere(1000, np.random.default_rng(7))
    normal = -radial
    normal[0] *= -1
    fit = fit_sphere(point, normal, rng=np.random.default_rng(8))
    assert fit.normal_rad.median < 1e-9
    assert fit.normal_rad.mean == pytest.approx(np.pi / 1000, abs=1e-9)


@pytest.mark.parametrize("fit", [least_squares_sphere, least_squares_plane])
def test_too_few_points_are_one_sentence(fit) -> None:
    with pytest.raises(ReconError, match="needs"):
        fit(np.zeros((2, 3)))


def test_sphere_through_a_flat_sheet_is_refused() -> None:
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    with pytest.raises(ReconError, match="one plane"):
        least_squares_sphere(np.stack([x, y, np.ones((5, 5))], axis=2).reshape(-1, 3))


def test_ransac_finds_a_plane_under_60_percent_outliers() -> None:
    rng = np.random.default_rng(9)
    normal = unit(np.array([[0.2, -0.4, 0.9]]))[0]
    point = rng.uniform(-30, 30, (5000, 3))
    on_plane = rng.random(5000) < 0.4
    flat = point - (point @ normal - 5.0)[:, None] * normal
    point[on_plane] = flat[on_plane] + 0.1 * rng.standard_normal((on_plane.sum(), 1)) * normal
    plane = ransac_plane(point, threshold_mm=0.5, rng=rng)
    sign = np.sign(plane.normal @ normal)
    # 2,000 inliers of 0.1 mm and 83 outliers within ±0.5 mm, over a span of 35 mm (root of a third of 60 mm).
    assert np.allclose(sign * plane.normal, normal, atol=2e-3)
    assert sign * plane.offset_mm == pytest.approx(5.0, abs=0.03)


def test_plane_is_judged_over_all_its_points() -> None:
    rng = np.random.default_rng(10)
    point = np.column_stack([rng.uniform(-20, 20, (20_000, 2)), rng.standard_normal(20_000)])
    normal = np.broadcast_to([0.0, 0.0, -1.0], point.shape).copy()
    fit = fit_plane(point, normal, rng=rng)
    # A unit Gaussian: 38.3 % within half a sd; mean magnitude 0.798 sd.
    assert fit.inlier_share == pytest.approx(0.383, abs=0.02)
    assert fit.position_mm.mean == pytest.approx(0.798, abs=0.02)
    assert fit.normal_rad.median < 0.02


def test_least_squares_plane_error_is_that_of_a_mean() -> None:
    rng = np.random.default_rng(11)
    x, y = np.meshgrid(np.linspace(-10, 10, 20), np.linspace(-10, 10, 20))
    found = [
        least_squares_plane(np.stack([x, y, 0.1 * rng.standard_normal(x.shape)], axis=2).reshape(-1, 3))
        for _ in range(100)
    ]
    at_origin = np.array([plane.offset_mm / plane.normal[2] for plane in found])
    assert np.sqrt(np.mean(at_origin**2)) == pytest.approx(0.1 / 20, rel=4 / np.sqrt(200))


def test_exact_cylinder_is_found_to_rounding() -> None:
    point, radial, truth = half_cylinder(1000, np.random.default_rng(12))
    fit = fit_cylinder(point, radial, rng=np.random.default_rng(13))
    assert fit.cylinder.radius_mm == pytest.approx(14.18, abs=1e-8)
    assert abs(fit.cylinder.axis @ truth.axis) == pytest.approx(1.0, abs=1e-12)
    assert fit.height_mm == pytest.approx(44.73, rel=0.01)
    assert fit.inlier_share == 1.0


def test_cylinder_is_found_among_60_percent_outliers_with_poor_normals() -> None:
    rng = np.random.default_rng(14)
    point, radial, truth = half_cylinder(6000, rng, noise_mm=0.1)
    stray = rng.random(6000) < 0.6
    point[stray] = CENTRE_MM + rng.uniform(-40, 40, (int(stray.sum()), 3))
    normal = np.where(stray[:, None], directions(6000, rng), tilted(radial, 0.1, rng))
    fit = fit_cylinder(point, normal, rng=rng)
    assert fit.cylinder.radius_mm == pytest.approx(14.18, abs=0.1)
    assert abs(fit.cylinder.axis @ truth.axis) > np.cos(0.01)


def test_error_of_a_fitted_cylinder_is_what_its_normal_equations_promise() -> None:
    rng = np.random.default_rng(15)
    point, radial, truth = half_cylinder(400, rng)
    along = (point - CENTRE_MM) @ truth.axis
    first = unit(np.cross(truth.axis[None], [[0.0, 0.0, 1.0]]))[0]
    u, v = radial @ first, radial @ np.cross(truth.axis, first)
    slopes = np.column_stack([u, v, u * along, v * along, np.ones(400)])
    promised = 0.1 * np.sqrt(np.linalg.inv(slopes.T @ slopes)[4, 4])
    found = [
        least_squares_cylinder(point + 0.1 * rng.standard_normal((400, 1)) * radial, start=truth).radius_mm - 14.18
        for _ in range(60)
    ]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(promised, rel=4 / np.sqrt(120))


def test_parallel_normals_give_no_cylinder() -> None:
    rng = np.random.default_rng(16)
    point = np.column_stack([rng.uniform(-5, 5, (50, 2)), np.zeros(50)])
    with pytest.raises(ReconError, match="no cylinder fits"):
        fit_cylinder(point, np.broadcast_to([0.0, 0.0, 1.0], (50, 3)).copy(), rng=rng)


@settings(max_examples=10, deadline=None)
@given(scale=st.floats(0.01, 100))
def test_scaling_the_scene_scales_every_fit(scale: float) -> None:
    point, normal = hemisphere(300, np.random.default_rng(17), noise_mm=0.2)
    one, other = (fit_sphere(f * point, normal, rng=np.random.default_rng(1)) for f in (1.0, scale))
    assert other.sphere.radius_mm == pytest.approx(scale * one.sphere.radius_mm)
    assert other.position_mm.rms == pytest.approx(scale * one.position_mm.rms)
    point, normal, _ = half_cylinder(300, np.random.default_rng(18), noise_mm=0.1)
    one_c, other_c = (
        fit_cylinder(f * point, normal, rng=np.random.default_rng(1), threshold_mm=0.5 * f) for f in (1.0, scale)
    )
    assert other_c.cylinder.radius_mm == pytest.approx(scale * one_c.cylinder.radius_mm)
    assert other_c.height_mm == pytest.approx(scale * one_c.height_mm)


def test_order_of_the_points_does_not_matter() -> None:
    rng = np.random.default_rng(19)
    point, normal = hemisphere(500, rng, noise_mm=0.2)
    order = rng.permutation(500)
    one = fit_sphere(point, normal, rng=np.random.default_rng(1))
    other = fit_sphere(point[order], normal[order], rng=np.random.default_rng(1))
    assert other.sphere.radius_mm == pytest.approx(one.sphere.radius_mm, abs=1e-6)


def gem(rng: np.random.Generator, noise_rad: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A six-sided pyramid seen from above, whose facets slope by 35°, with a flat surround outside the mask."""
    row, col = np.mgrid[-80:81, -80:81].astype(float)
    sector = np.floor((np.arctan2(row, col) + np.pi) / (np.pi / 3)).clip(0, 5)
    azimuth = -np.pi + (sector + 0.5) * np.pi / 3
    slope = np.tan(np.radians(35.0))
    normal = np.stack([slope * np.cos(azimuth), slope * np.sin(azimuth), np.ones_like(row)], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    height = -slope * (col * np.cos(azimuth) + row * np.sin(azimuth))
    point = 0.2 * np.stack([col, row, height], axis=2)
    noisy = tilted(normal.reshape(-1, 3), noise_rad, rng).reshape(normal.shape)
    return point, noisy, np.hypot(row, col) < 75


def test_six_facets_of_a_gem_are_told_apart_by_noisy_normals() -> None:
    rng = np.random.default_rng(20)
    point, normal, mask = gem(rng, noise_rad=np.radians(3.0))
    facets = fit_facets(point, normal, mask, rng=rng, most_facets=6)
    assert len(facets.planes) == 6
    sizes = [int((facets.number == k).sum()) for k in range(6)]
    assert min(sizes) > 0.9 * mask.sum() / 6
    assert all(fit.inlier_share > 0.99 for fit in facets.planes)
    slopes = [np.degrees(np.arccos(fit.plane.normal[2])) for fit in facets.planes]
    assert slopes == pytest.approx([35.0] * 6, abs=0.5)


def test_two_parallel_facets_apart_in_the_photo_are_two() -> None:
    rng = np.random.default_rng(21)
    normal = np.broadcast_to([0.0, 0.0, 1.0], (40, 60, 3)).copy()
    normal[:, 25:35] = unit(np.array([[1.0, 0.0, 1.0]]))[0]
    number = facets_by_normal(normal, np.ones((40, 60), bool), rng=rng, most_facets=6)
    assert number.max() == 2
    assert number[0, 0] != number[0, -1]


def test_nothing_faceted_is_one_sentence() -> None:
    rng = np.random.default_rng(22)
    normal = directions(900, rng).reshape(30, 30, 3)
    with pytest.raises(ReconError, match="no facet"):
        fit_facets(normal.copy(), normal, np.ones((30, 30), bool), rng=rng, most_facets=6)


def test_ransac_score_is_the_share_of_inliers() -> None:
    residual = np.array([[0.0, 0.4, -0.6, 2.0], [9.0, 9.0, 9.0, 0.1]])
    assert ransac_score(residual, threshold_mm=0.5).tolist() == [0.5, 0.25]


def test_mlesac_prefers_the_tighter_of_two_fits_with_equal_inliers() -> None:
    residual = np.array([[0.4, 0.4, 0.4, 9.0], [0.1, 0.1, 0.1, 9.0]])
    tight, loose = mlesac_score(residual, threshold_mm=0.5, span_mm=50.0)[[1, 0]]
    assert tight > loose


def test_spread_leaves_out_what_is_missing() -> None:
    spread = spread_of(np.array([3.0, -4.0, np.nan]))
    assert (spread.count, spread.mean, spread.median) == (2, 3.5, 3.5)
    assert spread.rms == pytest.approx(np.sqrt(12.5))
    assert np.isnan(spread_of(np.array([np.nan])).mean)


@given(angle=st.floats(0, np.pi), seed=st.integers(0, 1000))
def test_angle_between_unit_vectors_is_exact_at_both_ends(angle: float, seed: int) -> None:
    first, other = directions(2, np.random.default_rng(seed))[:, None]
    across = unit(np.cross(first, other))
    second = np.cos(angle) * first + np.sin(angle) * across
    assert angle_between_rad(first, second)[0] == pytest.approx(angle, abs=1e-14)


def test_two_hundred_thousand_points_take_seconds() -> None:
    rng = np.random.default_rng(23)
    point, radial, _ = half_cylinder(200_000, rng, noise_mm=0.3)
    start = time.process_time()
    fit = fit_cylinder(point, tilted(radial, 0.1, rng), rng=rng)
    assert time.process_time() - start < 10
    assert fit.cylinder.radius_mm == pytest.approx(14.18, abs=0.05)
