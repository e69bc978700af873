"""Weights by the photon transfer curve, two factors that are not negative by SciPy's solver, leverages by the hat matrix."""

import numpy as np
import pytest
from scipy.optimize import nnls

from recon.sweeps.curve_samples import write_weights
from recon.sweeps.leverage import write_leverage
from recon.sweeps.noise import _two_not_negative

SAMPLES = 9


@pytest.mark.parametrize("factors", [(0.05, 1e-3), (0.05, -1e-3), (-0.05, 1e-3), (-0.05, -1e-3)])
def test_two_factors_that_are_not_negative_are_those_of_scipy(factors: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    place = rng.uniform(1, 200, 12)
    terms = np.stack([place, place**2], axis=1)
    wanted = terms @ factors + rng.normal(0, 0.1, 12)
    assert _two_not_negative(terms, wanted) == pytest.approx(nnls(terms, wanted)[0], rel=1e-9, abs=1e-12)


def test_leverages_are_the_diagonal_of_the_hat_matrix() -> None:
    rng = np.random.default_rng(5)
    curve, by_place, by_width = rng.normal(0, 1, (3, 20, SAMPLES))
    weight = rng.uniform(0.5, 2, (20, SAMPLES))
    leverage = np.empty_like(curve)
    write_leverage(curve, by_place, by_width, weight, 0.0, np.zeros(20), leverage)
    for pixel in range(20):
        design = np.stack([curve[pixel], np.ones(SAMPLES), by_place[pixel], by_width[pixel]], axis=1)
        scaled = np.sqrt(weight[pixel])[:, None] * design
        # A ridge of a thousand millionth keeps poor designs solvable.
        np.testing.assert_allclose(leverage[pixel], np.diag(scaled @ np.linalg.pinv(scaled)), atol=1e-6)


def test_what_is_known_of_the_background_and_the_width_takes_leverage_away() -> None:
    """Of one sample with the background alone, the fit follows w / (w + b)."""
    nothing, one = np.zeros((1, 1)), np.ones((1, 1))
    leverage = np.empty((1, 1))
    write_leverage(nothing, nothing, nothing, one, 3.0, np.ones(1), leverage)
    assert leverage[0, 0] == pytest.approx(1 / 4, rel=1e-6)
    write_leverage(nothing, nothing, 2 * one, one, 1e5, 12 * np.ones(1), leverage)
    assert leverage[0, 0] == pytest.approx(4 / 16, rel=1e-3)


def test_a_sample_weighs_one_over_its_variance_by_the_photon_transfer_curve_or_nothing() -> None:
    height = np.array([[-3.0, 0.0, 10.0, 10.0]], dtype=np.float32)
    usable = np.array([[True, True, True, False]])
    weight = np.empty((1, 4), dtype=np.float32)
    write_weights(height, usable, 4.0, 0.5, 0.1, weight)
    # Read noise of 2 counts; then 5 of shot noise and (1 count)² of what grows with the signal; no light has less than none.
    np.testing.assert_allclose(weight, [[1 / 4, 1 / 4, 1 / (4 + 5 + 1), 0]], rtol=1e-6)
