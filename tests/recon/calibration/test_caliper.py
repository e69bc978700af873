"""The caliper check, on triangles whose sides are whole numbers."""

import numpy as np
import pytest

from recon.calibration.caliper import caliper_check, panel_check
from recon.calibration.errors import CalibrationError
from recon.sessions.manifest import DisplayPanel

PANEL = DisplayPanel(columns=1024, rows=768, pitch_mm=0.1)
A = ("left mark", np.array([0.0, 0.0, 0.0]))
B = ("right mark", np.array([3.0, 4.0, 12.0]))  # 3² + 4² + 12² = 13²


def test_a_length_that_agrees_is_told_with_both_numbers() -> None:
    check = caliper_check(A, B, 0.01**2 * np.eye(6), caliper_mm=13.02, caliper_sd_mm=0.02)
    assert check.found_mm == pytest.approx(13.0)
    # Two points of 0.01 mm each along their line: 0.01 √2.
    assert check.found_sd_mm == pytest.approx(0.01 * np.sqrt(2))
    assert check.agrees()
    assert check.sentence().startswith("the scale is right (left mark to right mark: 13.020 mm")


def test_a_length_that_differs_gives_the_factor_of_the_pitch() -> None:
    check = caliper_check(A, B, 1e-8 * np.eye(6), caliper_mm=13.13, caliper_sd_mm=0.02)
    assert not check.agrees()
    assert check.ratio() == pytest.approx(1.01)
    assert "1.01000" in check.sentence()
    assert "correct the display's pitch" in check.sentence()


def test_an_error_that_both_points_share_does_not_count() -> None:
    shared = np.tile(np.eye(3), (2, 2))
    assert caliper_check(A, B, shared, caliper_mm=13.0, caliper_sd_mm=0.02).found_sd_mm == pytest.approx(0.0, abs=1e-9)


def test_a_stretch_of_the_panel_follows_from_the_pitch() -> None:
    check = panel_check(PANEL, 400.0, pitch_sd_share=0.001, caliper_mm=40.0, caliper_sd_mm=0.02)
    assert check.found_mm == pytest.approx(40.0)
    assert check.found_sd_mm == pytest.approx(0.04)


@pytest.mark.parametrize(("length_mm", "sd_mm"), [(0.0, 0.02), (10.0, 0.0)])
def test_a_length_without_uncertainty_is_refused(length_mm: float, sd_mm: float) -> None:
    with pytest.raises(CalibrationError, match="a steel caliper has"):
        caliper_check(A, B, np.eye(6), caliper_mm=length_mm, caliper_sd_mm=sd_mm)


def test_more_pixels_than_the_panel_has_are_refused() -> None:
    with pytest.raises(CalibrationError, match="the display has 1 to 1024"):
        panel_check(PANEL, 1025.0, pitch_sd_share=0.001, caliper_mm=1.0, caliper_sd_mm=0.02)
