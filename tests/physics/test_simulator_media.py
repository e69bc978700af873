"""Glasses, water, glass of varying index, and relief, against data sheets and closed forms."""

import numpy as np
import pytest
from scipy.optimize import brentq

from sim_backend.optics.media import IndexVariation, sellmeier_index, water_index
from sim_backend.optics.relief import Heights, Relief, Rings, Ripples, Scales
from sim_backend.optics.shapes import cylinder, slab
from sim_backend.optics.solids import intersection
from sim_backend.optics.tracer import Body, OpticalWorld, trace


@pytest.mark.parametrize(
    ("glass", "n_d", "abbe_number"),
    # Schott's and Heraeus' data sheets.
    [("N-BK7", 1.51680, 64.17), ("N-SF11", 1.78472, 25.68), ("fused silica", 1.45846, 67.82)],
)
def test_glasses_have_the_index_and_abbe_number_of_their_data_sheets(
    glass: str, n_d: float, abbe_number: float
) -> None:
    d_line, f_line, c_line = (sellmeier_index(glass, wavelength) for wavelength in (587.5618, 486.1327, 656.2725))
    assert d_line == pytest.approx(n_d, abs=1e-5)
    assert (d_line - 1) / (f_line - c_line) == pytest.approx(abbe_number, abs=0.02)


def test_water_has_the_tabulated_index_and_falls_with_wavelength() -> None:
    assert water_index(465.0) == pytest.approx(1.3387, abs=1e-9)
    assert water_index(530.0) == pytest.approx(1.3355, abs=1e-9)
    assert water_index(620.0) == pytest.approx(1.3325, abs=1e-9)
    # The sodium line at 20 °C: 1.33299 (CRC Handbook of Chemistry and Physics); the table has four decimals.
    assert water_index(589.3) == pytest.approx(1.33299, abs=5e-4)


def test_a_layered_plate_keeps_the_sine_and_shifts_by_the_integral_of_its_slope() -> None:
    # n(z) sin θ is constant, so x = ∫ s / √(n(z)² − s²) dz = (s / b) [arcosh(n / s)] for n = n0 + b z.
    n0, slope, thickness, sine = 1.45, 0.02, 10.0, np.sin(0.6)
    shift = sine / slope * (np.arccosh((n0 + slope * thickness) / sine) - np.arccosh(n0 / sine))
    errors = []
    for step in (0.4, 0.2):
        body = Body(intersection(*slab(0, thickness)), n0, variation=IndexVariation(slope, 0.0, step))
        direction = np.array([[sine, 0.0, np.cos(0.6)]])
        paths = trace(OpticalWorld((body,)), -5 * direction, direction)
        assert paths.direction[0, 0] == pytest.approx(sine, abs=1e-5)
        errors.append(abs(paths.exit_point[0, 0] - shift))
    assert errors[1] < 1e-4
    # The midpoint rule: half the step, a quarter of the error.
    assert errors[1] < errors[0] / 3


def test_a_gradient_rod_of_half_a_pitch_turns_an_image_upside_down() -> None:
    # n = n0 − a r²: near the axis r'' = −(2a / n0) r, so after π / √(2a / n0) every height is reversed.
    n0, a, height = 1.6, 0.004, 0.05
    half_pitch = np.pi / np.sqrt(2 * a / n0)
    rod = intersection(cylinder((0, 0, 0), (0, 0, 1), 3.0), *slab(0, float(half_pitch)))
    body = Body(rod, n0, variation=IndexVariation(0.0, -a, 0.05))
    paths = trace(OpticalWorld((body,)), np.array([[height, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]]))
    # Beyond the paraxial form the error is of the order of a h² / n0.
    assert paths.exit_point[0, 0] == pytest.approx(-height, rel=1e-4)
    assert paths.direction[0, 0] == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("heights", [Rings(3.0, 0.6, 40.0), Scales(3.0, 0.6, 45.0)])
def test_relief_has_the_depth_it_was_given_and_slopes_that_are_its_derivative(heights: Heights) -> None:
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(-60, 60, 241), np.linspace(-60, 60, 241)))
    height = heights.height(x, y)
    assert height.max() == pytest.approx(3.0, abs=1e-3)
    assert height.min() == pytest.approx(2.4, abs=1e-3)
    step = 1e-4
    slope_x, slope_y = heights.slopes(x, y)
    np.testing.assert_allclose(
        slope_x, (heights.height(x + step, y) - heights.height(x - step, y)) / (2 * step), atol=1e-8
    )
    np.testing.assert_allclose(
        slope_y, (heights.height(x, y + step) - heights.height(x, y - step)) / (2 * step), atol=1e-8
    )


def test_rays_meet_a_relief_on_its_surface_and_flat_rays_pass_it_by() -> None:
    rng = np.random.default_rng(8)
    relief = Relief(Scales(3.0, 0.6, 45.0))
    origin = np.column_stack([rng.uniform(-80, 80, (500, 2)), rng.uniform(-50, 50, 500)])
    direction = rng.normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    found = relief.crossings(origin, direction)
    steep = np.abs(direction[:, 2]) > 0.3
    np.testing.assert_array_equal(np.isfinite(found.distance[:, 0]), steep)
    points = origin[steep] + found.distance[steep] * direction[steep]
    np.testing.assert_allclose(relief.value(points), 0, atol=1e-9)
    np.testing.assert_array_equal(found.starts_inside[steep], direction[steep, 2] > 0)


def test_slanted_rays_meet_steep_ripples_where_the_sine_says() -> None:
    # Slopes of 0.79 across rays that lean as much: Newton's method alone would jump a period.
    middle, amplitude, wavelength, lean = 9.0, 0.05, 0.4, 0.36
    rng = np.random.default_rng(9)
    origin = np.column_stack([rng.uniform(-5, 5, (300, 2)), np.zeros(300)])
    direction = np.column_stack([rng.uniform(-0.9, 0.9, 300), rng.uniform(-0.3, 0.3, 300), np.ones(300)])
    found = Relief(Ripples(middle, amplitude, wavelength, lean)).crossings(origin, direction)

    def above(distance: float, start: np.ndarray, along: np.ndarray) -> float:
        x, y, z = start + distance * along
        return float(z - middle - lean * y - amplitude * np.sin(2 * np.pi * x / wavelength))

    expected = [brentq(above, 0.0, 30.0, args=pair, xtol=1e-13) for pair in zip(origin, direction, strict=True)]
    np.testing.assert_allclose(found.distance[:, 0], expected, atol=1e-11)


def test_the_slopes_of_ripples_are_the_derivative_of_their_height() -> None:
    ripples, step = Ripples(9.0, 0.05, 0.4, 0.36), 1e-6
    x, y = np.random.default_rng(2).uniform(-3, 3, (2, 50))
    for slope, (right, down) in zip(ripples.slopes(x, y), ((step, 0.0), (0.0, step)), strict=True):
        rise = ripples.height(x + right, y + down) - ripples.height(x - right, y - down)
        np.testing.assert_allclose(slope, rise / (2 * step), atol=1e-8)
