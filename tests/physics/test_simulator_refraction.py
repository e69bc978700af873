"""The simulator's refraction against Snell's law, Fermat's principle and the Fresnel equations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from sim_backend.optics.refraction import facing, fresnel_transmission, refract

angles = st.floats(0.001, 1.55)
indices = st.floats(1.0, 2.5)


def bend(angle_rad: float, n_from: float, n_to: float) -> tuple[np.ndarray, bool]:
    direction = np.array([[np.sin(angle_rad), 0.0, np.cos(angle_rad)]])
    normal = facing(direction, np.array([[0.0, 0.0, 1.0]]))
    bent, reflected = refract(direction, normal, np.array([n_from]), np.array([n_to]))
    return bent[0], bool(reflected[0])


@settings(deadline=None)  # the machine may be busy
@given(angles, indices, indices)
def test_obeys_the_law_of_sines_or_reflects_beyond_the_critical_angle(angle: float, n_from: float, n_to: float) -> None:
    bent, reflected = bend(angle, n_from, n_to)
    sine = n_from * np.sin(angle) / n_to
    if abs(sine - 1) < 1e-9:
        return
    assert reflected == (sine > 1)
    if reflected:
        np.testing.assert_allclose(bent, [np.sin(angle), 0, -np.cos(angle)], atol=1e-12)
    else:
        np.testing.assert_allclose(bent, [sine, 0, np.sqrt(1 - sine**2)], atol=1e-9)


@settings(deadline=None)  # the machine may be busy
@given(angles, indices, indices)
def test_the_way_back_is_the_way_there_reversed(angle: float, n_from: float, n_to: float) -> None:
    bent, reflected = bend(angle, n_from, n_to)
    if reflected or bent[2] < 1e-3:
        return
    back, _ = refract(
        -bent[None], facing(-bent[None], np.array([[0.0, 0.0, 1.0]])), np.array([n_to]), np.array([n_from])
    )
    np.testing.assert_allclose(back[0], [-np.sin(angle), 0, -np.cos(angle)], atol=1e-9)


def test_glass_to_air_turns_to_total_reflection_at_41_8_degrees() -> None:
    assert not bend(np.radians(41.80), 1.5, 1.0)[1]
    assert bend(np.radians(41.82), 1.5, 1.0)[1]


def test_light_takes_the_path_of_stationary_optical_length() -> None:
    # From (0, -3) in air to (2, 4) in glass through the plane z = 0: minimise the optical length over the crossing.
    best = minimize_scalar(lambda x: np.hypot(x, 3) + 1.5 * np.hypot(2 - x, 4), bounds=(0, 2), options={"xatol": 1e-10})
    bent, _ = bend(float(np.arctan2(best.x, 3)), 1.0, 1.5)
    # The optical length is flat at its minimum, so the minimiser knows x to about the root of its rounding.
    np.testing.assert_allclose(best.x + 4 * bent[0] / bent[2], 2, atol=1e-6)


@settings(deadline=None)  # the machine may be busy
@given(indices, indices)
def test_straight_through_loses_the_square_of_the_index_contrast(n_from: float, n_to: float) -> None:
    kept = fresnel_transmission(np.ones(1), np.array([n_from]), np.array([n_to]))[0]
    assert kept == pytest.approx(1 - ((n_from - n_to) / (n_from + n_to)) ** 2, abs=1e-12)


def test_light_polarised_in_the_plane_passes_whole_at_the_angle_of_brewster() -> None:
    # There only the other polarisation reflects, by ((n² - 1) / (n² + 1))² (Hecht, Optics, 4.6).
    n = 1.5
    kept = fresnel_transmission(np.array([np.cos(np.arctan(n))]), np.ones(1), np.array([n]))[0]
    assert kept == pytest.approx(1 - 0.5 * ((n**2 - 1) / (n**2 + 1)) ** 2, abs=1e-12)


@settings(deadline=None)  # the machine may be busy
@given(angles, indices, indices)
def test_as_much_passes_one_way_as_the_other_and_never_more_than_all(angle: float, n_from: float, n_to: float) -> None:
    bent, reflected = bend(angle, n_from, n_to)
    there = fresnel_transmission(np.array([np.cos(angle)]), np.array([n_from]), np.array([n_to]))[0]
    assert 0 <= there <= 1 + 1e-12
    if not reflected and bent[2] > 1e-3:
        back = fresnel_transmission(bent[2:3], np.array([n_to]), np.array([n_from]))[0]
        assert there == pytest.approx(back, abs=1e-9)
