"""Fringes read back: places from closed forms, their scatter, and a real display seen in a real mirror."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from recon.calibration.level_response import drive_levels, fit_levels
from recon.calibration.response_record import level_record
from recon.errors import SessionError
from recon.patterns.phase_shift import fringe, periods_for, phase_shift_levels
from recon.sessions.pattern import PhaseShiftPattern
from recon.sweeps.display_response import response_undone
from recon.sweeps.phase_shift import Phases, PhaseTracker, unwrapped

FACET = Path(__file__).parents[1] / "data/opencsp-sofast-facet/facet.npz"
AREA_PX = 2048.0


def pattern(*, frequencies: int = 3, steps: int = 8) -> PhaseShiftPattern:
    periods = periods_for(AREA_PX, finest_px=16.0, frequencies=frequencies)
    return PhaseShiftPattern(kind="phase_shift", periods_px=periods, steps=steps, first_px=0.0, last_px=AREA_PX - 1.0)


def phases_of(samples: np.ndarray, one: PhaseShiftPattern) -> Phases:
    tracker = PhaseTracker(samples.shape[1], one)
    for counts in samples:
        tracker.feed(counts)
    return tracker.finish()


def samples_of(place_px: np.ndarray, one: PhaseShiftPattern) -> np.ndarray:
    return np.stack([10 + 180 * fringe(one, index, place_px) for index in range(one.count)])


@pytest.mark.parametrize(("frequencies", "steps"), [(1, 3), (2, 4), (3, 8), (5, 5)])
def test_any_number_of_periods_and_phases_gives_every_place_back(frequencies: int, steps: int) -> None:
    one = pattern(frequencies=frequencies, steps=steps)
    place_px = np.linspace(0, AREA_PX - 1, 5001)
    phases = phases_of(samples_of(place_px, one), one)
    found = unwrapped(phases.turns, np.full(phases.turns.shape, 1e-6), one)
    np.testing.assert_allclose(found.place_px, place_px, atol=1e-6)
    np.testing.assert_allclose(phases.amplitude, 90, rtol=1e-9)
    np.testing.assert_allclose(phases.misfit, 0, atol=1e-6)
    assert found.consistent.all()


def test_the_scatter_of_a_phase_is_that_of_the_cramer_rao_bound() -> None:
    """For a cosine of amplitude A in N samples with noise σ the bound is σ √(2/N) / A (Kay, Estimation Theory, 1993, ch. 3)."""
    one, sigma = pattern(), 4.0
    place_px = np.full(20000, 777.25)
    noise = sigma * np.random.default_rng(3).standard_normal((one.count, 20000))
    phases = phases_of(samples_of(place_px, one) + noise, one)
    found = unwrapped(phases.turns, np.full(phases.turns.shape, 1e-4), one)
    bound_px = sigma * np.sqrt(2 / 8) / 90 * 16 / (2 * np.pi)
    # The relative scatter of a standard deviation from 20,000 values is 0.5 %.
    assert np.std(found.place_px - place_px) == pytest.approx(bound_px, rel=0.02)


def test_eight_phases_shed_the_overtones_of_a_display_with_gamma() -> None:
    one = pattern()
    place_px = np.linspace(100, 1900, 4001)
    bent = (samples_of(place_px, one) / 190) ** 2.2 * 190
    phases = phases_of(bent, one)
    found = unwrapped(phases.turns, np.full(phases.turns.shape, 1e-4), one)
    assert np.abs(found.place_px - place_px).max() < 0.01


def test_two_periods_that_contradict_each_other_are_not_believed() -> None:
    one = pattern()
    phases = phases_of(samples_of(np.array([400.0, 800.0]), one), one)
    turns = phases.turns.copy()
    turns[1, 0] += 0.45 * 16 / one.periods_px[1]
    found = unwrapped(turns, np.full(turns.shape, 1e-4), one)
    np.testing.assert_array_equal(found.consistent, [False, True])


def test_a_coarse_period_too_noisy_to_choose_the_finer_one_is_not_believed() -> None:
    one = pattern()
    phases = phases_of(samples_of(np.array([400.0]), one), one)
    sd = np.array([[1e-4], [0.02], [1e-3]])  # 0.02 turns of 190 px are 3.8 px: five of them are more than half of 16 px
    assert not unwrapped(phases.turns, sd, one).consistent.any()


def test_the_frames_are_the_fringes_in_drive_levels_and_dark_beyond_the_area() -> None:
    one = pattern().model_copy(update={"first_px": 64.0, "last_px": 1983.0})
    levels = phase_shift_levels(one, 17, device_px=int(AREA_PX))
    assert not levels[:64].any()
    assert not levels[1984:].any()
    turns = (np.arange(64, 1984) - 64) / 16 - 1 / 8
    np.testing.assert_allclose(levels[64:1984] / 255, np.cos(np.pi * turns) ** 2, atol=0.5 / 255 + 1e-9)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"periods_px": (900.0, 16.0)}, "longer than the area"),
        ({"periods_px": (1100.0, 16.0, 16.0)}, "the coarsest first"),
        ({"last_px": 1.0}, "3 device pixels"),
    ],
)
def test_fringes_that_leave_places_in_doubt_are_refused(changes: dict[str, object], reason: str) -> None:
    fields = {"kind": "phase_shift", "periods_px": (1100.0, 16.0), "steps": 4, "first_px": 0.0, "last_px": 999.0}
    with pytest.raises(ValidationError, match=reason):
        PhaseShiftPattern.model_validate({**fields, **changes})


def test_a_real_display_in_a_real_mirror_is_read_to_a_millionth_of_the_screen() -> None:
    """OpenCSP's SOFAST published the fractions of the screen that these photos of a mirror facet come to."""
    with np.load(FACET) as facet:
        seen = facet["fringe_images"][facet["mask"]].astype(np.float64).T
        expected, periods = facet["expected_screen_fraction"], (facet["periods_y"], facet["periods_x"])
        level, value = facet["display_values"], facet["camera_values"]
    linear = drive_levels(seen, level=level, value=value)
    # The axis of the rows is measured from the other end of the screen.
    for photos, fringes, fraction in (
        (linear[:16], periods[0], 1 - expected[1]),
        (linear[16:], periods[1], expected[0]),
    ):
        # A screen of 1,000 pixels reaches from −½ to 999½; its fringes begin at its edge.
        one = PhaseShiftPattern(
            kind="phase_shift", periods_px=tuple(1000 / fringes), steps=4, first_px=-0.5, last_px=998.5
        )
        phases = phases_of(photos, one)
        found = unwrapped(phases.turns, np.full(phases.turns.shape, 1e-4), one)
        assert found.consistent.all()
        assert np.abs((found.place_px + 0.5) / 1000 - fraction).max() < 1e-6


def test_without_the_response_the_real_display_is_off_by_more_than_a_millionth() -> None:
    with np.load(FACET) as facet:
        seen = facet["fringe_images"][facet["mask"]].astype(np.float64).T[16:]
        expected, periods = facet["expected_screen_fraction"][0], facet["periods_x"]
    one = PhaseShiftPattern(kind="phase_shift", periods_px=tuple(1000 / periods), steps=4, first_px=-0.5, last_px=998.5)
    phases = phases_of(seen, one)
    found = unwrapped(phases.turns, np.full(phases.turns.shape, 1e-4), one)
    assert np.abs((found.place_px + 0.5) / 1000 - expected).max() > 1e-5


def test_the_response_of_a_display_is_undone_exactly_at_the_levels_that_were_measured() -> None:
    level = np.linspace(0, 255, 18)
    value = 4 + 220 * (level / 255) ** 2.2
    measured = fit_levels(level, value, np.zeros(18), full_scale=255.0)
    np.testing.assert_allclose(drive_levels(value, level=measured.level, value=measured.monotone), level, atol=1e-9)


def test_a_response_of_other_photos_is_refused_in_one_sentence() -> None:
    level = np.linspace(0, 255, 18)
    record = level_record(fit_levels(level, 4 + 220 * (level / 255) ** 2.2, np.zeros(18), full_scale=255.0))
    with pytest.raises(
        SessionError, match=r"response\.json: it was measured with counts up to 255, .* 65535; measure it"
    ):
        response_undone(np.zeros((2, 2), np.uint16), record)
    counts = np.rint(4 + 220 * (np.array([[0.0, 60.0, 255.0]]) / 255) ** 2.2).astype(np.uint8)
    np.testing.assert_allclose(response_undone(counts, record), [0.0, 60.0, 255.0], atol=2.5)
