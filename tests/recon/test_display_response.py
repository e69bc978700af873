"""Response, latency, flicker, drift and primary of a display, from numbers made by their laws."""

import numpy as np
import pytest

from recon.calibration.brightness_drift import drift_warnings, fit_drift
from recon.calibration.display_light import clipped_share, lit_region, mean_value, row_values
from recon.calibration.flicker import (
    Flicker,
    Swing,
    bands_of,
    fit_flicker,
    flicker_warnings,
    safe_times,
    swing_of,
)
from recon.calibration.latency import fit_latency, fit_rolling_latency, latency_warnings
from recon.calibration.level_response import LevelResponse, fit_levels, level_warnings
from recon.calibration.primary_planes import measure_planes, primary_warnings

LEVELS = np.repeat(np.linspace(0, 255, 18), 3)
NO_CLIPPING = np.zeros(LEVELS.size)


def response(gamma: float, *, noise: float, seed: int, black: float = 5.0, white: float = 220.0) -> LevelResponse:
    rng = np.random.default_rng(seed)
    values = black + (white - black) * (LEVELS / 255) ** gamma + rng.normal(0, noise, LEVELS.size)
    return fit_levels(LEVELS, values, NO_CLIPPING, full_scale=255.0)


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2, 2.6])
def test_the_gamma_of_a_display_is_found(gamma: float) -> None:
    found = response(gamma, noise=0.0, seed=1)
    assert found.gamma == pytest.approx(gamma, abs=1e-6)
    assert (found.black, found.white) == (pytest.approx(5.0, abs=1e-4), pytest.approx(220.0, abs=1e-4))
    assert level_warnings(found) == ()


def test_errors_of_gamma_over_its_standard_deviation_have_unit_variance() -> None:
    """Of 200 normal numbers the root mean square is 1 ± 0.05; four of these are allowed, and the t of 15 repeats' 36 dof."""
    errors = []
    for seed in range(200):
        found = response(2.2, noise=0.7, seed=seed)
        errors.append((found.gamma - 2.2) / found.gamma_sd)
    assert 0.8 < float(np.sqrt(np.mean(np.square(errors)))) < 1.2


def test_the_table_undoes_the_response_at_levels_between_those_measured() -> None:
    table = response(2.2, noise=0.0, seed=1).light_table()
    assert table[0] == 0
    assert table[255] == pytest.approx(1)
    np.testing.assert_allclose(table, (np.arange(256) / 255) ** 2.2, atol=2e-3)
    assert (np.diff(table) >= 0).all()


def test_a_response_that_falls_is_told_with_its_remedy() -> None:
    values = 5 + 200 * (LEVELS / 255)
    values[LEVELS == 255] = 150
    found = fit_levels(LEVELS, values, NO_CLIPPING, full_scale=255.0)
    assert found.residual_rms > 5
    assert (np.diff(found.monotone) >= 0).all()
    assert any("darker photo: switch off the display's dynamic contrast" in text for text in level_warnings(found))


def test_levels_that_clip_are_named_and_left_out_of_the_fit() -> None:
    true = 5 + 400 * (LEVELS / 255) ** 2.2
    found = fit_levels(LEVELS, np.minimum(true, 255), (true >= 254).astype(float), full_scale=255.0)
    assert found.gamma == pytest.approx(2.2, abs=1e-3)
    assert found.clipped_from == 210  # 5 + 400 · (210 / 255) ** 2.2 = 266; the level below, 195, gives 227
    assert "Photos clip from level 210" in level_warnings(found)[0]


def test_too_few_levels_are_refused() -> None:
    with pytest.raises(ValueError, match="2 levels do not clip, 5 are needed"):
        fit_levels(np.array([0.0, 255.0]), np.array([1.0, 200.0]), np.zeros(2), full_scale=255.0)


AFTER_S = np.linspace(0.03, 0.4, 24)


def shares(after_s: np.ndarray, *, latency_s: float, exposure_s: float, rise_s: float) -> np.ndarray:
    """The share of the new frame by summing a million moments of each exposure, light rising in a straight line."""
    moments = (np.arange(20_000) + 0.5) / 20_000 * exposure_s
    lit = np.clip((after_s[:, None] + moments - latency_s) / rise_s, 0, 1)
    return lit.mean(axis=1)


@pytest.mark.parametrize("exposure_s", [0.02, 0.1, 0.25])
def test_a_latency_of_120_ms_is_found_with_any_exposure_time(exposure_s: float) -> None:
    seen = shares(AFTER_S, latency_s=0.12, exposure_s=exposure_s, rise_s=0.008)
    seen += np.random.default_rng(3).normal(0, 0.003, seen.size)
    found = fit_latency(AFTER_S, seen, exposure_s=exposure_s)
    assert found.latency_sd_s < 0.003
    assert abs(found.latency_s - 0.124) < 4 * found.latency_sd_s  # the light begins at 120 ms and is whole at 128 ms
    assert abs(found.rise_s - 0.008) < 4 * found.rise_sd_s
    assert found.settled_s >= 0.126


def test_errors_of_latency_over_its_standard_deviation_have_unit_variance() -> None:
    errors = []
    clean = shares(AFTER_S, latency_s=0.12, exposure_s=0.1, rise_s=0.03)
    for seed in range(50):
        noise = np.random.default_rng(seed).normal(0, 0.005, clean.size)
        found = fit_latency(AFTER_S, clean + noise, exposure_s=0.1)
        errors.append((found.latency_s - 0.135) / found.latency_sd_s)
    assert 0.75 < float(np.sqrt(np.mean(np.square(errors)))) < 1.25


def test_a_rolling_shutter_is_told_from_a_late_display() -> None:
    """Rows at 0.3 and 0.7 of the photo open 6 and 14 ms after its first one, which opens with the command."""
    after_s = np.linspace(0.03, 0.4, 24)
    halves = [shares(after_s + 0.02 * row, latency_s=0.12, exposure_s=0.1, rise_s=1e-6) for row in (0.3, 0.7)]
    noise = np.random.default_rng(3).normal(0, 0.002, (after_s.size, 2))
    found = fit_rolling_latency(after_s, np.column_stack(halves) + noise, exposure_s=0.1, at_share=(0.3, 0.7))
    assert abs(found.latency_s - 0.12) < 4 * found.latency_sd_s
    assert abs(found.readout_s - 0.02) < 4 * found.readout_sd_s
    assert found.readout_sd_s < 0.003
    still = [shares(after_s, latency_s=0.12, exposure_s=0.1, rise_s=1e-6)] * 2
    found = fit_rolling_latency(after_s, np.column_stack(still) + noise, exposure_s=0.1, at_share=(0.3, 0.7))
    assert found.readout_s == 0
    assert abs(found.latency_s - 0.12) < 4 * found.latency_sd_s


def test_a_capture_that_waits_too_short_is_told_how_long() -> None:
    found = fit_latency(AFTER_S, shares(AFTER_S, latency_s=0.12, exposure_s=0.1, rise_s=1e-6), exposure_s=0.1)
    (warning,) = latency_warnings(found, waits_s=0.1)
    assert "raise settle_s in section [timing] by 0.0" in warning
    assert latency_warnings(found, waits_s=0.2) == ()


@pytest.mark.parametrize(
    ("share", "sentence"),
    [
        (np.zeros(8), "no photo up to 0.40 s"),
        (np.ones(8), "every photo from 0.030 s"),
        (np.ones(3), "3 photos were taken"),
    ],
)
def test_photos_from_which_no_latency_follows_are_refused(share: np.ndarray, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        fit_latency(np.linspace(0.03, 0.4, share.size), share, exposure_s=0.1)


SHUTTERS_S = 1 / np.array([1000, 800, 640, 500, 400, 320, 250, 200, 160, 125, 100, 80, 60])


def rows_of(
    exposure_s: float, *, frequency_hz: float, depth: float, readout_s: float, noise: float, photos: int, seed: int
) -> np.ndarray:
    """Means of 300 rows by the integral of 1 + d · sin(2πft), photos at random moments."""
    rng = np.random.default_rng(seed)
    opened_s = rng.uniform(0, 1, photos)[:, None] + np.arange(300) / 300 * readout_s
    turn = 2 * np.pi * frequency_hz
    swing = (np.cos(turn * opened_s) - np.cos(turn * (opened_s + exposure_s))) / (turn * exposure_s)
    return 180 * (1 + depth * swing) * (1 + rng.normal(0, noise, opened_s.shape))


@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_a_flicker_of_240_hz_is_found_by_either_shutter(readout_s: float) -> None:
    swings = [
        swing_of(
            rows_of(each, frequency_hz=240, depth=0.3, readout_s=readout_s, noise=0.002, photos=12, seed=number),
            exposure_s=each,
        )
        for number, each in enumerate(SHUTTERS_S)
    ]
    found = fit_flicker(swings)
    assert found.found
    assert abs(found.frequency_hz - 240) < 3 * found.frequency_sd_hz
    assert found.frequency_sd_hz < 8
    assert abs(found.depth - 0.3) < 3 * found.depth_sd


def test_a_steady_display_has_no_flicker() -> None:
    swings = [
        swing_of(
            rows_of(each, frequency_hz=240, depth=0.0, readout_s=0.02, noise=0.002, photos=8, seed=number),
            exposure_s=each,
        )
        for number, each in enumerate(SHUTTERS_S)
    ]
    found = fit_flicker(swings)
    assert not found.found
    assert flicker_warnings(found, exposure_s=1 / 1000) == ()


def test_bands_give_the_frequency_where_the_readout_time_is_known() -> None:
    """240 Hz in a readout of 20 ms: 4.8 bands a photo."""
    rows = rows_of(1 / 1000, frequency_hz=240, depth=0.3, readout_s=0.02, noise=0.002, photos=6, seed=5)
    bands = bands_of(rows)
    assert bands is not None
    assert bands.per_photo == pytest.approx(4.8, abs=4 * bands.per_photo_sd + 2e-3)
    assert bands.swing == pytest.approx(0.3 * np.sinc(0.24), rel=0.05)
    steady = rows_of(1 / 1000, frequency_hz=240, depth=0.0, readout_s=0.02, noise=0.002, photos=6, seed=5)
    assert bands_of(steady) is None


def test_shutter_times_that_hold_whole_periods_are_advised() -> None:
    """1/60 s holds four periods of 240 Hz, 1/80 s three; 1/100 s holds 2.4 and leaves sinc(2.4) of it."""
    flicker = Flicker(240.0, 0.01, 0.3, 0.01, found=True)
    safe = [float(each) for each in safe_times(flicker, largest_swing=0.005)]
    assert {1 / 80, 1 / 60, 1 / 40, 1 / 30} <= set(safe)
    assert 1 / 100 not in safe
    (warning,) = flicker_warnings(flicker, exposure_s=1 / 100)
    assert "240.0 Hz" in warning
    assert "multiple of 4.17 ms (near: 8.333 ms)" in warning
    assert flicker.swing_at(1 / 100) == pytest.approx(0.3 * abs(np.sinc(2.4)), abs=1e-3)


def test_a_frequency_from_three_shutter_times_is_refused() -> None:
    with pytest.raises(ValueError, match="4 shutter times or more"):
        fit_flicker([Swing(each, 0.1, 0.01) for each in SHUTTERS_S[:3]])


def test_a_drift_is_found_with_its_standard_deviation() -> None:
    time_s = np.linspace(0, 600, 40)
    errors = []
    for seed in range(100):
        noise = np.random.default_rng(seed).normal(0, 0.3, time_s.size)
        found = fit_drift(time_s, 10 + 200 * (1 + 0.002 * (time_s / 60 - 5)) + noise, black=10.0)
        errors.append((found.per_min - 0.002) / found.per_min_sd)
    assert 0.75 < float(np.sqrt(np.mean(np.square(errors)))) < 1.25
    (warning,) = drift_warnings(fit_drift(time_s, 200 * (1 + 0.002 * (time_s / 60 - 5)), black=0.0), sweep_s=1200.0)
    assert "gains 4.0 % of its brightness in a sweep of 20 min" in warning
    assert drift_warnings(found, sweep_s=60.0) == ()


def picture(value: int, *, side: int = 40) -> np.ndarray:
    photo = np.full((60, 80), 3, np.uint8)
    photo[5 : 5 + side, 10 : 10 + side] = value
    return photo


def test_the_display_is_found_in_a_photo_and_read() -> None:
    region = lit_region(picture(200), picture(4))
    assert region.sum() == 1600
    assert mean_value(picture(100), region) == 100
    assert clipped_share(picture(255), region) == 1.0
    rows = row_values(picture(100), region)
    assert np.isfinite(rows).sum() == 40
    assert np.nanmax(rows) == 100


def test_a_display_that_is_not_in_the_photo_gives_an_empty_region() -> None:
    region = lit_region(picture(3), picture(3))
    assert not region.any()
    assert np.isnan(mean_value(picture(3), region))


def coloured(blue: int, green: int, red: int) -> np.ndarray:
    photo = np.zeros((20, 20, 3), np.uint8)
    photo[...] = (blue, green, red)
    return photo


def test_the_planes_of_one_primary_are_told_apart() -> None:
    everywhere = np.ones((20, 20), bool)
    dark = coloured(2, 2, 2)
    green = measure_planes(coloured(12, 202, 22), dark, everywhere)
    np.testing.assert_allclose(green.share, [0.05, 1.0, 0.1])
    assert primary_warnings(green, "green") == ()
    assert "lit most in green" in primary_warnings(green, "red")[0]
    mixed = measure_planes(coloured(102, 202, 22), dark, everywhere)
    assert "Another plane gets 50 % of the light of green" in primary_warnings(mixed, "green")[0]
    grey = measure_planes(coloured(100, 100, 100), dark, everywhere)
    assert "The photos are grey" in primary_warnings(grey, "green")[0]
    assert primary_warnings(grey, "white") == ()
