"""Whole light paths against closed forms: plates, balls, hemispheres, prisms, cover glass."""

import numpy as np
import pytest

from sim_backend.optics.screen import ScreenPose, hit_screen
from sim_backend.optics.shapes import half_space, slab, sphere
from sim_backend.optics.solids import intersection
from sim_backend.optics.tracer import Body, OpticalWorld, trace


def slanted(angle_rad: float, start: tuple[float, float, float] = (0.0, 0.0, -10.0)) -> tuple[np.ndarray, np.ndarray]:
    return np.array([start], dtype=np.float64), np.array([[np.sin(angle_rad), 0.0, np.cos(angle_rad)]])


@pytest.mark.parametrize("angle_deg", [0.0, 5.0, 40.0, 80.0])
def test_a_plane_plate_shifts_a_ray_sideways_and_keeps_its_direction(angle_deg: float) -> None:
    # Shift = t sin(θ) (1 - cos θ / √(n² - sin² θ)) (Born and Wolf, 4.8).
    thickness, n, angle = 3.0, 1.52, np.radians(angle_deg)
    paths = trace(OpticalWorld((Body(intersection(*slab(0, thickness)), n),)), *slanted(angle))
    direction = np.array([np.sin(angle), 0, np.cos(angle)])
    np.testing.assert_allclose(paths.direction[0], direction, atol=1e-12)
    entry = np.array([10 * np.tan(angle), 0, 0])
    across = np.array([np.cos(angle), 0, -np.sin(angle)])
    shift = thickness * np.sin(angle) * (1 - np.cos(angle) / np.sqrt(n**2 - np.sin(angle) ** 2))
    assert (paths.exit_point[0] - entry) @ across == pytest.approx(-shift, abs=1e-9)
    np.testing.assert_allclose(paths.exit_normal[0], [0, 0, 1])


def test_the_liquid_surface_bends_a_ray_that_misses_the_object() -> None:
    liquid = Body(half_space((0, 0, 0), (0, 0, -1)), 1.33, of_object=False)
    paths = trace(OpticalWorld((liquid,)), *slanted(np.radians(30)))
    assert paths.direction[0, 0] == pytest.approx(0.5 / 1.33, abs=1e-12)
    assert paths.n[0] == 1.33
    assert not paths.touched_object()[0]


@pytest.mark.parametrize("height", [0.01, 5.0, 9.0, 17.0])
def test_a_ball_turns_a_ray_by_twice_the_difference_of_its_two_angles(height: float) -> None:
    # Each surface turns the ray by i - r with sin i = h / R = n sin r.
    radius, n = 20.0, 1.5
    paths = trace(
        OpticalWorld((Body(sphere((0, 0, 0), radius), n),)), np.array([[height, 0, -100.0]]), np.array([[0.0, 0, 1]])
    )
    incidence = np.arcsin(height / radius)
    turn = 2 * (incidence - np.arcsin(height / radius / n))
    assert np.arcsin(-paths.direction[0, 0]) == pytest.approx(turn, abs=1e-10)
    np.testing.assert_allclose(paths.exit_normal[0], paths.exit_point[0] / radius, atol=1e-10)


def test_a_ball_lens_has_its_paraxial_focus_at_n_r_over_two_n_minus_one() -> None:
    # Effective focal length n R / (2 (n - 1)) from the centre (lensmaker's equation for a thick lens).
    radius, n, height = 10.0, 1.5, 1e-3
    paths = trace(
        OpticalWorld((Body(sphere((0, 0, 0), radius), n),)), np.array([[height, 0, -50.0]]), np.array([[0.0, 0, 1]])
    )
    focus = paths.origin[0, 2] - paths.origin[0, 0] * paths.direction[0, 2] / paths.direction[0, 0]
    # Spherical aberration is of the order of h² / R.
    assert focus == pytest.approx(n * radius / (2 * (n - 1)), abs=1e-5)


@pytest.mark.parametrize("n_outside", [1.0, 1.3355])
def test_a_hemisphere_leaves_by_the_closed_form_in_air_and_in_water(n_outside: float) -> None:
    radius, n, height = 27.99, 1.5195, 9.0
    dome = Body(intersection(sphere((0, 0, 0), radius), half_space((0, 0, 0), (0, 0, -1))), n)
    liquid = Body(half_space((0, 0, 1), (0, 0, -1)), n_outside, of_object=False)
    paths = trace(OpticalWorld((liquid, dome)), np.array([[height, 0, -420.0]]), np.array([[0.0, 0, 1]]))
    np.testing.assert_allclose(paths.exit_point[0], [height, 0, np.sqrt(radius**2 - height**2)], atol=1e-9)
    inner = np.arcsin(height / radius)
    outer = np.arcsin(n * height / radius / n_outside)
    assert np.arcsin(-paths.direction[0, 0]) == pytest.approx(outer - inner, abs=1e-10)


def test_a_right_angled_prism_reflects_totally_and_sends_the_light_out_sideways() -> None:
    # Long face 45° to the ray: 45° is beyond the critical angle of n = 1.5.
    prism = intersection(
        half_space((0, 0, 0), (0, 0, -1)), half_space((-5, 0, 0), (-1, 0, 0)), half_space((0, 0, 5), (1, 0, 1))
    )
    paths = trace(OpticalWorld((Body(prism, 1.5),)), np.array([[0.0, 0, -10]]), np.array([[0.0, 0, 1]]))
    np.testing.assert_allclose(paths.direction[0], [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(paths.exit_point[0], [-5, 0, 5], atol=1e-9)
    # Two faces met head on: each keeps 0.96 of the light, the total reflection all of it.
    assert paths.transmission[0] == pytest.approx(0.96**2, abs=1e-12)


def test_a_face_that_lies_in_the_liquid_surface_counts_once() -> None:
    liquid = Body(half_space((0, 0, 0), (0, 0, -1)), 1.3, of_object=False)
    glass = Body(intersection(*slab(0, 4)), 1.5)
    paths = trace(OpticalWorld((liquid, glass)), *slanted(0.5))
    assert paths.direction[0, 0] == pytest.approx(np.sin(0.5) / 1.3, abs=1e-12)
    first = fresnel(0.5, 1.0, 1.5)
    second = fresnel(float(np.arcsin(np.sin(0.5) / 1.5)), 1.5, 1.3)
    assert paths.transmission[0] == pytest.approx(first * second, abs=1e-12)


def fresnel(angle: float, n_from: float, n_to: float) -> float:
    """Unpolarised transmission from the tangent and sine forms (Hecht, Optics, 4.6)."""
    out = np.arcsin(n_from * np.sin(angle) / n_to)
    across = (np.sin(angle - out) / np.sin(angle + out)) ** 2
    within = (np.tan(angle - out) / np.tan(angle + out)) ** 2
    return float(1 - (across + within) / 2)


def test_a_bubble_of_the_same_index_as_its_surroundings_changes_the_path_only_by_its_walls() -> None:
    # A concentric hollow ball: by the conservation of n r sin θ a ray leaves at the angle of a ball of both parts.
    outer, inner, n, height = 14.0, 12.0, 1.52, 5.0
    world = OpticalWorld((Body(sphere((0, 0, 0), outer), n), Body(sphere((0, 0, 0), inner), 1.0)))
    paths = trace(world, np.array([[height, 0, -100.0]]), np.array([[0.0, 0, 1]]))
    steps = [
        (np.arcsin(height / outer), np.arcsin(height / (n * outer))),
        (np.arcsin(height / (n * inner)), np.arcsin(height / inner)),
    ]
    turn = 2 * sum(before - after for before, after in steps)
    assert np.arcsin(-paths.direction[0, 0]) == pytest.approx(turn, abs=1e-10)
    assert np.linalg.norm(paths.exit_point[0]) == pytest.approx(outer, abs=1e-9)


def test_a_ray_that_finds_no_way_out_is_called_trapped() -> None:
    # A ray inside a ball beyond the critical angle meets the surface at that angle for ever.
    paths = trace(
        OpticalWorld((Body(sphere((0, 0, 0), 1.0), 1.5),)), np.array([[0.9, 0.0, 0.0]]), np.array([[0.0, 0, 1]])
    )
    assert paths.trapped[0]


POSE = ScreenPose(np.array([0.0, 0.0, 30.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 70.0])
@pytest.mark.parametrize("n_outside", [1.0, 1.33])
def test_cover_glass_bends_oblique_rays_exactly(angle_deg: float, n_outside: float) -> None:
    thickness, n_glass, angle = 1.5, 1.51, np.radians(angle_deg)
    origin, direction = slanted(angle, (0, 0, 0))
    hits = hit_screen(POSE, origin, direction, np.array([n_outside]), glass_thickness_mm=thickness, glass_n=n_glass)
    sine = n_outside * np.sin(angle) / n_glass
    wanted = (30 - thickness) * np.tan(angle) + thickness * sine / np.sqrt(1 - sine**2)
    assert hits.x_mm[0] == pytest.approx(wanted, abs=1e-12)


def test_steep_rays_see_the_pixels_at_the_apparent_depth() -> None:
    # t / n below the glass for rays near the normal.
    thickness, n_glass, angle = 3.0, 1.5, 1e-4
    origin, direction = slanted(angle, (0, 0, 0))
    hits = hit_screen(POSE, origin, direction, np.ones(1), glass_thickness_mm=thickness, glass_n=n_glass)
    assert hits.x_mm[0] / np.tan(angle) == pytest.approx(30 - thickness + thickness / n_glass, abs=1e-7)


def test_a_ray_that_looks_away_from_the_screen_misses_it() -> None:
    hits = hit_screen(POSE, np.array([[0.0, 0, 0]]), np.array([[0.0, 0.6, -0.8]]), np.ones(1))
    assert np.isnan(hits.x_mm[0])
    assert hits.transmission[0] == 0
