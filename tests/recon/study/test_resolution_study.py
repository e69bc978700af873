"""The study of resolution: its measures against closed forms, and its scenes against their own truth."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from recon.study.height_transfer import Ripples, edge_of, height_transfer
from recon.study.noisy_sweeps import load_true_session
from recon.study.resolution import SERIES, judged_face, points_by_series, ripples
from recon.study.simulator import simulated
from recon.study.wedge_scenes import AMPLITUDE_MM, ROLL_DEG, Wedge, rippled_wedge


def test_transfer_has_the_sd_that_white_noise_gives_a_projection() -> None:
    rng = np.random.default_rng(4)
    column = np.tile(np.arange(120.0), (320, 1))
    true = 0.05 * np.sin(2 * np.pi * column / 7)
    transfer = height_transfer([Ripples(0.6 * true + 0.02 * rng.standard_normal(true.shape), true)])
    # Least squares on one regressor: σ / √Σ true².
    expected = 0.02 / np.sqrt((true**2).sum())
    # The spread of 40 groups is known to 1 / √(2 · 39) = 11 %.
    assert transfer.sd == pytest.approx(expected, rel=4 * 0.11)
    assert transfer.ratio == pytest.approx(0.6, abs=4 * expected)


def test_a_blurred_step_rises_over_2_56_sd_and_does_not_overshoot() -> None:
    offset = np.random.default_rng(5).uniform(-20, 20, 200_000)
    edge = edge_of(offset, 3.0 + 0.25 * norm.cdf(offset / 1.5), step_mm=0.5)
    # The levels are reached to 3e-5 of the step, 6 px from it; a bin of 0.25 px adds 0.1 % to the sd.
    assert edge.width_px == pytest.approx(2 * norm.ppf(0.9) * 1.5, rel=0.01)
    assert edge.ratio == pytest.approx(0.5, rel=1e-3)
    assert edge.overshoot < 1e-3


def test_a_step_that_rings_overshoots_by_what_was_put_in() -> None:
    offset = np.linspace(-20, 20, 4001)
    height = np.where(offset > 0, 1.0 + 0.2 * (offset < 1), 0.0)
    assert edge_of(offset, height, step_mm=1.0).overshoot == pytest.approx(0.2, abs=1e-9)


def test_no_step_has_no_width() -> None:
    edge = edge_of(np.linspace(-20, 20, 400), np.zeros(400), step_mm=0.5)
    assert edge.ratio == 0
    assert np.isnan(edge.width_px)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    wedge = Wedge(48)
    scene = rippled_wedge(wedge, wavelength_mm=8 * wedge.footprint_mm)
    return simulated(scene, tmp_path_factory.mktemp("ripples"), options=["--truth-only"])


def test_a_pixel_of_the_wedge_sees_the_footprint_that_wavelengths_are_counted_in(folder: Path) -> None:
    wedge, truth = Wedge(48), load_true_session(folder).truth
    along = np.diff(truth.point_mm[..., 0], axis=1)[judged_face(truth, wedge)[:, 1:]]
    # The face leans: half the square is up to 1.5 % nearer or farther, and the photo is rolled.
    assert np.nanmedian(along) == pytest.approx(wedge.footprint_mm * np.cos(np.radians(ROLL_DEG)), rel=0.005)


def test_ripples_of_eight_pixels_stay_in_the_surface_and_their_true_height_is_that_of_the_scene(folder: Path) -> None:
    wedge, session = Wedge(48), load_true_session(folder)
    face = judged_face(session.truth, wedge)
    points = points_by_series(session, 0.01, np.random.default_rng(1))
    seen = {name: ripples(points[name], session.truth, face, wedge) for name in SERIES}
    assert np.nanmax(seen["surface, full"].true_mm) == pytest.approx(AMPLITUDE_MM, rel=1e-3)
    chords = np.pi / 8 / np.tan(np.pi / 8)
    assert height_transfer([seen["surface, paper"]]).ratio == pytest.approx(chords, abs=0.01)
    assert height_transfer([seen["surface, full"]]).ratio > chords
