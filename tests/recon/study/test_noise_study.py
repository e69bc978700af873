"""The noise studies, held against closed forms: how far noise on the display moves a point and turns a normal."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from recon.cli import app
from recon.errors import ReconError
from recon.evaluation.coverage import Coverage, Share, coverage_of, directions_alike
from recon.study.coverage_tables import outside_by_chance
from recon.study.noise_rounds import noise_rounds
from recon.study.noisy_sweeps import load_true_session, noisy_sweeps
from recon.study.scenes import semi_ellipsoid
from recon.study.simulator import simulated, toml_text
from recon.study.total_reflection import critical_entry_radius


@pytest.fixture(scope="module")
def session_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = semi_ellipsoid(size=48, stage=(10.0, 20.0), n_liquid=1.3)
    return simulated(scene, tmp_path_factory.mktemp("study"), options=["--truth-only"])


def test_noise_is_as_large_as_asked_and_stated(session_folder: Path) -> None:
    session = load_true_session(session_folder)
    sweeps = noisy_sweeps(session, sd_px=0.3, rng=np.random.default_rng(1))
    error = sweeps["pos1_liquid", "y"].place_px - session.place_px["pos1_liquid"][..., 1]
    drawn = error[np.isfinite(error)]
    assert drawn.std() == pytest.approx(0.3, rel=4 / np.sqrt(2 * drawn.size))
    assert np.nanmax(sweeps["pos1_liquid", "y"].sd_px) == pytest.approx(0.3)


def test_errors_grow_with_the_noise_as_long_as_it_is_small(session_folder: Path) -> None:
    session = load_true_session(session_folder)
    small, large = (
        noise_rounds(session, sd_px=sd_px, rounds=2, rng=np.random.default_rng(2))["paper"] for sd_px in (0.02, 0.04)
    )
    assert large.position_rms / small.position_rms == pytest.approx(2, rel=0.05)
    assert large.normal_rms_deg / small.normal_rms_deg == pytest.approx(2, rel=0.05)
    assert 0 < small.kept <= 1


def test_points_without_noise_are_those_of_the_truth(session_folder: Path) -> None:
    session = load_true_session(session_folder)
    errors = noise_rounds(session, sd_px=1e-6, rounds=1, rng=np.random.default_rng(3))
    assert errors["paper"].position_rms < 1e-5
    assert errors["paper"].normal_rms_deg < 1e-4


def test_coverage_of_errors_as_large_as_stated_is_95_percent_in_every_tenth() -> None:
    rng = np.random.default_rng(4)
    sd = rng.uniform(0.1, 3.0, 40_000)
    error = np.linalg.norm(rng.standard_normal((len(sd), 2)), axis=1) * sd / np.sqrt(2)
    number = np.arange(len(sd)) % 20
    found = coverage_of(error, sd, number)
    # Binomial: 0.11 % for all, 0.34 % for a tenth; 4 sigma.
    assert found.whole.value == pytest.approx(0.95, abs=0.0044)
    assert [share.value for share in found.by_decile] == pytest.approx([0.95] * 10, abs=0.0138)
    # Stated half as large as they are, the intervals hold 1 − 0.05^(1/4) of them.
    half = coverage_of(error, sd / 2, number).whole.value
    assert half == pytest.approx(1 - 0.05**0.25, abs=4 * 0.5 / np.sqrt(len(sd)))


@pytest.mark.parametrize("across", [0.0, 0.3, 1.0, 3.0, np.inf])
def test_coverage_of_points_is_95_percent_whatever_their_errors_across_the_surface(across: float) -> None:
    rng = np.random.default_rng(7)
    sds = np.array([0.0, 0.0, 1.0] if across == np.inf else [1.0, 1.0, across])
    error = np.linalg.norm(sds * rng.standard_normal((100_000, 3)), axis=1)
    sd, across_sd = (np.full(len(error), each) for each in (np.linalg.norm(sds), sds[2]))
    found = coverage_of(error, sd, np.arange(len(sd)) % 20, directions=directions_alike(sd, across_sd))
    # Binomial 0.07 %, and 0.13 % by the match of moments.
    assert found.whole.value == pytest.approx(0.95, abs=0.004)


def test_the_interval_of_three_directions_alike_ends_where_tables_of_chi_squared_say() -> None:
    # 7.815 for three degrees of freedom, at 95 %; 5.991 for two would be 8.987 here.
    sd, number = np.full(10, np.sqrt(3.0)), np.zeros(10, np.int64)
    for squared, within in ((7.80, 1.0), (7.83, 0.0)):
        error = np.full(10, np.sqrt(squared))
        assert coverage_of(error, sd, number, directions=np.full(10, 3.0)).whole.value == within


def test_what_pixels_of_a_round_share_widens_the_sampling_of_a_coverage() -> None:
    rng = np.random.default_rng(5)
    number = np.repeat(np.arange(400), 100)
    pixels = np.linalg.norm(rng.standard_normal((len(number), 2)), axis=1)
    shared = np.linalg.norm(rng.standard_normal((400, 2)), axis=1)[number]
    sd = np.full(len(number), np.sqrt(2))
    # Binomial with as many independent errors as there are; the sd of 400 rounds is known to 1/√800, kurtosis doubles that.
    for error, independent in ((pixels, len(number)), (shared, 400)):
        assert coverage_of(error, sd, number).whole.sd == pytest.approx(np.sqrt(0.95 * 0.05 / independent), rel=0.3)
    assert np.isnan(coverage_of(shared, sd, np.zeros_like(number)).whole.sd)


def test_a_coverage_misses_clearly_only_beyond_its_sampling() -> None:
    low, high = Share(0.92, 0.004), Share(0.978, 0.005)
    assert [share.outside(0.93, 0.97) for share in (low, high, Share(0.96, 0.0))] == [True, True, False]
    assert [share.clearly_outside(0.93, 0.97, sampling_sds=2.0) for share in (low, high)] == [True, False]


def test_tenths_that_miss_by_chance_are_those_of_the_tails_of_a_normal_distribution() -> None:
    # Half of the tenths err by the goal's half-width (31.73 % miss, as a table of one sigma says), the others by a quarter of it.
    tenths = tuple(Share(0.95, sd) for sd in 5 * (0.02, 0.005))
    assert outside_by_chance([Coverage(tenths[0], tenths)] * 2) == pytest.approx(2 * 5 * 0.3173, abs=0.05)
    assert outside_by_chance([Coverage(tenths[0], (Share(0.95, np.nan),))]) is None


def test_intervals_of_the_full_method_are_told_and_the_paper_has_none(session_folder: Path) -> None:
    errors = noise_rounds(load_true_session(session_folder), sd_px=0.2, rounds=1, rng=np.random.default_rng(6))
    assert errors["paper"].point_coverage is None
    told = errors["full"].point_coverage, errors["full"].normal_coverage
    assert all(one is not None and 0.9 < one.whole.value < 0.99 for one in told)


def test_the_critical_radius_is_that_of_a_ray_along_the_axis_for_a_camera_far_away() -> None:
    # For parallel light the incidence at the dome is the arc sine of r / R: r = R / n. A camera at 60 sees a little more.
    assert 10 / 1.5 < critical_entry_radius() < 10 / 1.5 * 1.02


def test_a_scene_is_written_as_toml_that_reads_back() -> None:
    scene = semi_ellipsoid(size=48, stage=(10.0, 20.0), n_liquid=1.3)
    assert tomllib.loads(toml_text(scene)) == json.loads(json.dumps(scene))


def test_an_unknown_study_is_named_with_those_that_there_are(tmp_path: Path) -> None:
    ran = CliRunner().invoke(app, ["study", "hemisfere", "--out", str(tmp_path)])
    assert "choose one of: noise-baseline, " in str(ran.exception)
    assert "hemisphere" in CliRunner().invoke(app, ["study"]).output


def test_another_simulation_is_never_written_over(session_folder: Path) -> None:
    scene = semi_ellipsoid(size=32, stage=(10.0, 20.0), n_liquid=1.3)
    with pytest.raises(ReconError, match="holds another simulation"):
        simulated(scene, session_folder.parent, options=["--truth-only"])
