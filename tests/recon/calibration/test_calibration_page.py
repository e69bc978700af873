"""The page of a geometric calibration: its verdict, what it draws, and what it says where something was not kept."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_calibration_file import calibration, fields

from recon.calibration.display_motion import slips_of, straightness_of
from recon.calibration.errors import CalibrationError
from recon.report.calibration_camera import direction_sd_px
from recon.report.calibration_page import calibration_verdict, holds_until, write_calibration_page
from recon.report.photo_cells import cell_centres
from recon.report.slip_panel import slip_chart

SD_RAD, SD_MM = 1e-4, 0.01
SMALL = np.diag(([SD_RAD] * 3 + [SD_MM] * 3) * 3) ** 2
CELL = {"corners": 12, "residual_x_px": 0.01, "residual_y_px": -0.02}
EVIDENCE = {
    "lens_views": [
        {"name": "0001.jpg", "corners": 40, "rms_px": 0.07},
        {"name": "0002.jpg", "corners": 40, "rms_px": 0.61, "disagrees": True},
    ],
    "display_views": [{"name": "0003.jpg", "corners": 90, "corners_dropped": 2, "rms_px": 0.06, "pose": "pos1_liquid"}],
    "cells": [[CELL] * 7 + [CELL | {"corners": 0}]] * 6,
}


def quality(**changes: Any) -> dict[str, Any]:
    errors = {"fep_error_mm": 0.04, "fep_shape_error_mm": 0.008, "normal_error_deg": 0.03}
    return {"reprojection_rms_px": 0.05, "corner_sd_px": 0.04} | errors | changes


def page(folder: Path, **changes: Any) -> str:
    path = folder / "calibration.html"
    write_calibration_page(path, calibration(**({"covariance": SMALL.tolist(), "quality": quality()} | changes)))
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("changes", "grade", "sentence"),
    [
        ({}, "pass", "capture"),
        ({"warnings": ["camera: 0002.jpg disagrees"]}, "check", "Camera: 0002.jpg disagrees."),
        ({"quality": quality(fep_shape_error_mm=0.03)}, "check", "deform the object by 0.030 mm"),
        ({"quality": quality(fep_shape_error_mm=0.4)}, "fail", "photograph the board again"),
    ],
)
def test_the_verdict_follows_from_the_shape_error_and_the_warnings(
    changes: dict[str, Any], grade: str, sentence: str
) -> None:
    verdict = calibration_verdict(calibration(**({"quality": quality()} | changes)))
    assert verdict.grade == grade
    assert sentence in " ".join((*verdict.reasons, verdict.next_action))


def test_the_page_names_the_worst_photo_the_slip_and_the_last_day(tmp_path: Path) -> None:
    text = page(tmp_path, evidence=EVIDENCE)
    assert "in red: 0002.jpg" in text
    assert "display 1, wet" in text
    # The set pos1_liquid stands 0.3 mm to the right of pos1_air, with √2 · 0.01 mm of sd.
    assert "0.300 ± 0.014 mm" in text
    assert "slipped" in text
    assert holds_until(calibration()) == "19 June 2018"  # 30 days after 20 May
    assert "19 June 2018" in text
    assert "hatch" in text


def test_what_an_older_file_does_not_hold_is_said_and_not_drawn(tmp_path: Path) -> None:
    poses = {name: pose for name, pose in fields()["poses"].items() if name.endswith("air")}
    text = page(tmp_path, poses=poses, covariance=(), quality={"reprojection_rms_px": 0.05, "corner_sd_px": 0.04})
    assert text.count("calibrate again to see it") == 3
    assert "was not photographed under liquid" in text
    assert "no covariance of the poses" in text
    assert "taken as given" in text


def test_measured_pitch_and_glass_carry_their_standard_deviations(tmp_path: Path) -> None:
    display = {"columns": 5, "rows": 5, "pitch_mm": 1.003, "cover_glass": {"thickness_mm": 1.52, "n": 1.5}}
    text = page(tmp_path, display=display, quality=quality(pitch_sd_share=5e-4, cover_glass_sd_mm=0.11))
    assert "1.00300 ± 0.00050 mm, measured" in text
    assert "1.52 ± 0.11 mm, measured" in text


def test_a_simulated_calibration_says_so_first(tmp_path: Path) -> None:
    text = page(tmp_path, provenance={"devices": {"camera": {"kind": "simulated"}}})
    assert "Not a real rig." in text
    assert text.index("Not a real rig.") < text.index("Pass")


def test_a_folder_that_is_not_there_is_told_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"calibration\.html"):
        write_calibration_page(tmp_path / "none" / "calibration.html", calibration())


def test_straightness_and_slip_are_those_of_the_files_own_covariance() -> None:
    made = calibration(covariance=SMALL.tolist())
    straight = straightness_of(made)
    assert straight is not None
    assert straight.travel_mm == pytest.approx(40.0)
    assert straight.travel_sd_mm == pytest.approx(np.sqrt(2) * SD_MM)
    assert straight.turn_sd_rad == pytest.approx(np.sqrt(6) * SD_RAD)
    (slip,) = slips_of(made)
    assert slip.position == 1
    assert slip.moved[3:] == pytest.approx([0.3, 0, 0])
    # χ² of two numbers is below 5.991 with a chance of 95 %.
    chart = slip_chart(slip)
    edge = [tuple(map(float, word.split())) for word in str(chart["ellipse"]).strip("MZ").split("L")]
    wide = max(x for x, _ in edge) - min(x for x, _ in edge)
    ticks = chart["x_ticks"]
    assert isinstance(ticks, list)
    mm = (ticks[-1][0] - ticks[0][0]) / (2 * float(ticks[-1][1]))
    assert wide / mm == pytest.approx(2 * np.sqrt(5.991 * 2) * SD_MM, rel=0.02)


@pytest.mark.parametrize(("number", "left"), [(0, 1.0), (2, 0.0)])
def test_a_doubtful_focal_length_counts_and_a_doubtful_centre_is_a_turn_of_the_camera(number: int, left: float) -> None:
    # Far from a wide angle: 2000 px of focal length, 16 px of photo; a turn then shifts all of the picture alike.
    covariance = np.zeros((9, 9))
    covariance[number, number] = 1.0
    lens = fields()["camera"]["intrinsics"] | {"focal_x_px": 2000, "focal_y_px": 2000}
    camera = calibration(camera=fields()["camera"] | {"intrinsics": lens, "covariance": covariance.tolist()}).camera
    expected = np.abs(cell_centres(camera)[:, 0] - 7.5) / 2000  # of one px: the place's distance over the focal length
    # A turn shifts the edge of the picture by (8/2000)² more than its middle.
    assert direction_sd_px(camera) == pytest.approx(left * expected, abs=2 * (8 / 2000) ** 2)
