"""The calibration as a file: written and read whole, taken over into a session's world, refused where it does not fit."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.calibration.calibration_file import (
    Calibration,
    calibrated,
    in_world,
    parse_calibration,
    read_calibration,
    write_calibration,
)
from recon.calibration.errors import CalibrationError
from recon.calibration.validity import accepted, doubts
from recon.sessions.manifest import Manifest, Pose

PATTERN = {"profile": "hard", "width_px": 1.0, "first_px": 0.0, "step_px": 1.0, "count": 5}
STRAIGHT = {"x_axis": [1.0, 0.0, 0.0], "y_axis": [0.0, 1.0, 0.0]}


def fields(**changes: Any) -> dict[str, Any]:
    return {
        "schema_version": 1,
        "created": "2018-05-20T12:00:00Z",
        "display": {"columns": 5, "rows": 5, "pitch_mm": 1.0},
        "camera": {
            "columns": 16,
            "rows": 12,
            "settings": {"aperture": "8", "iso": "100"},
            "intrinsics": {"focal_x_px": 20, "focal_y_px": 20, "centre_x_px": 7.5, "centre_y_px": 5.5},
            "covariance": np.eye(9).tolist(),
        },
        "poses": {
            "pos0_air": {"centre_mm": [0, 0, 473], **STRAIGHT},
            "pos1_air": {"centre_mm": [0, 0, 513], **STRAIGHT},
            "pos1_liquid": {"centre_mm": [0.3, 0, 513], **STRAIGHT},
        },
        "covariance": np.eye(18).tolist(),
        "quality": {"reprojection_rms_px": 0.05, "corner_sd_px": 0.04},
        **changes,
    }


def calibration(**changes: Any) -> Calibration:
    return parse_calibration(json.dumps(fields(**changes)), source="test")


def session(**changes: Any) -> Manifest:
    camera = {"columns": 16, "rows": 12, "settings": {"aperture": "8", "iso": "400"}} | changes.pop("camera", {})
    sweeps = [{"axis": axis, "pattern": PATTERN} for axis in ("x", "y")]
    sets = [
        {"position": position, "condition": condition, "sweeps": sweeps}
        for condition in ("air", "liquid")
        for position in (0, 1)
    ]
    data = {
        "schema_version": 1,
        "name": "tiny",
        "created": "2018-06-01T12:00:00Z",
        "method": "liquid",
        "object": {"name": "glass"},
        "liquid": {"n": 1.333},
        "display": {"columns": 5, "rows": 5, "pitch_mm": 1.0},
        "display_poses": [{"centre_mm": [0.0, 0.0, z], **STRAIGHT} for z in (10.0, 20.0)],
        "camera": camera,
        "sets": sets,
    }
    return Manifest.model_validate(data | changes)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(path, calibration())
    assert read_calibration(path) == calibration()
    assert [entry.name for entry in tmp_path.iterdir()] == ["calibration.json"]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{", "not JSON"),
        (json.dumps({"schema_version": 2}), "schema_version is 2, this program reads 1"),
        (json.dumps(fields(poses={"pos0_air": {"centre_mm": [0, 0, 1], **STRAIGHT}})), "pos1_air missing"),
        (json.dumps(fields(covariance=np.eye(12).tolist())), "18 rows of 18 numbers"),
        (json.dumps(fields(created=3)), "created: must be text, found 3"),
    ],
)
def test_a_bad_file_is_told_in_one_sentence(text: str, sentence: str) -> None:
    with pytest.raises(CalibrationError, match=sentence):
        parse_calibration(text, source="calibration.json")


def test_a_missing_file_is_told_with_the_way_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="rig calibrate"):
        read_calibration(tmp_path / "none.json")


def test_a_session_takes_poses_lens_and_the_slip_of_one_set() -> None:
    taken = calibrated(session(), calibration())
    assert taken.display_poses[1].centre_mm == (0, 0, 513)
    assert taken.pose_of(taken.set_named("pos1_liquid")).centre_mm == (0.3, 0, 513)
    assert taken.pose_of(taken.set_named("pos0_liquid")).centre_mm == (0, 0, 473)
    assert taken.camera.intrinsics is not None
    assert taken.camera.intrinsics.focal_x_px == 20


def test_poses_are_moved_into_the_world_of_a_session_whose_camera_has_a_place() -> None:
    # The camera stands at (1, 2, 3) and looks along the world's −x axis; its x axis is the world's y.
    camera = Pose(centre_mm=(1, 2, 3), x_axis=(0, 1, 0), y_axis=(0, 0, -1))
    placed = in_world(Pose(centre_mm=(10, 20, 30), x_axis=(1, 0, 0), y_axis=(0, 1, 0)), camera)
    assert np.allclose(placed.centre_mm, (1 - 30, 2 + 10, 3 - 20))
    assert np.allclose(placed.x_axis, (0, 1, 0))
    assert np.allclose(placed.y_axis, (0, 0, -1))


def test_a_calibration_of_the_same_rig_twelve_days_old_is_accepted_without_a_word() -> None:
    assert doubts(calibration(), session()) == ()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"created": "2018-03-01T12:00:00Z"}, "92 days old when the session began, it holds for 30"),
        ({"created": "2018-06-20T12:00:00Z"}, "19 days after the session"),
        ({"created": "last week"}, "no ISO 8601 date"),
        ({"camera": fields()["camera"] | {"settings": {"aperture": "4"}}}, "aperture 4, the session with 8"),
    ],
)
def test_a_stale_calibration_or_other_settings_give_a_warning(changes: dict[str, Any], sentence: str) -> None:
    (warning,) = accepted(calibration(**changes), session(), source="calibration.json")
    assert sentence in warning


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"display": {"columns": 9, "rows": 5, "pitch_mm": 1.0}}, "display have 9 x 5 px, the session's 5 x 5"),
        ({"display": {"columns": 5, "rows": 5, "pitch_mm": 1.1}}, "another display"),
        ({"camera": fields()["camera"] | {"columns": 32}}, "photos have 32 x 12 px, the session's 16 x 12"),
    ],
)
def test_a_calibration_of_another_rig_is_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(CalibrationError, match=sentence):
        accepted(calibration(**changes), session(), source="calibration.json")


def test_a_session_of_another_camera_is_refused() -> None:
    other = fields()["camera"] | {"model": "Canon EOS 40D"}
    with pytest.raises(CalibrationError, match="of a Canon EOS 40D, the session of a Nikon"):
        accepted(calibration(camera=other), session(camera={"model": "Nikon"}), source="calibration.json")


def test_a_real_session_refuses_a_simulated_calibration() -> None:
    simulated = {"devices": {"camera": {"kind": "simulated"}}}
    real = {"devices": {"camera": {"kind": "real"}}}
    with pytest.raises(CalibrationError, match="calibrate the real one"):
        accepted(calibration(provenance=simulated), session(provenance=real), source="calibration.json")
