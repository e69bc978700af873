"""A session with a calibration beside its manifest: taken over, refused or doubted, and kept with the result."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from session_example import COLS, PLACES, ROWS, write_session

from recon.calibration.errors import CalibrationError
from recon.maps import load_maps
from recon.run import run_session
from recon.running.settings import Settings
from recon.sessions.importer import import_folder, read_layout
from recon.sessions.manifest import Manifest

DATA = Path(__file__).parents[1] / "data" / "povray-semi-ellipsoid"
STRAIGHT = {"x_axis": [1.0, 0.0, 0.0], "y_axis": [0.0, 1.0, 0.0]}


def write_calibration(path: Path, **changes: Any) -> Path:
    camera = {
        "columns": COLS,
        "rows": ROWS,
        "intrinsics": {"focal_x_px": 20, "focal_y_px": 20, "centre_x_px": 7.5, "centre_y_px": 5.5},
        "covariance": [[0.0] * 9] * 9,
    }
    fields = {
        "schema_version": 1,
        "created": "2018-05-20T12:00:00Z",
        "display": {"columns": PLACES, "rows": PLACES, "pitch_mm": 1.0},
        "camera": camera,
        "poses": {
            "pos0_air": {"centre_mm": [0, 0, 11], **STRAIGHT},
            "pos1_air": {"centre_mm": [0, 0, 22], **STRAIGHT},
            "pos1_liquid": {"centre_mm": [0.3, 0, 22], **STRAIGHT},
        },
        "quality": {"reprojection_rms_px": 0.05, "corner_sd_px": 0.04},
    }
    path.write_text(json.dumps(fields | changes))
    return path


@pytest.fixture(scope="module")
def glass_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture that was traced without our code; its unit is taken for the millimetre."""
    folder = tmp_path_factory.mktemp("glass") / "session"
    layout = read_layout(DATA / "hard.toml")
    in_mm = layout.manifest.model_copy(update={"length_unit": "mm", "created": "2018-06-01T12:00:00Z"})
    import_folder(DATA / "hard", folder, replace(layout, manifest=in_mm))
    return folder


def calibration_of(session: Path, path: Path, **changes: Any) -> Path:
    """Write a calibration that says what the session's manifest says, in the camera's frame (60 mm before the origin)."""
    manifest = json.loads((session / "manifest.json").read_text())
    camera = manifest["camera"]
    assert camera["pose"]["centre_mm"] == [0, 0, -60]
    poses = {
        f"pos{number}_air": {"centre_mm": [0, 0, pose["centre_mm"][2] + 60], **STRAIGHT}
        for number, pose in enumerate(manifest["display_poses"])
    }
    lens = {"columns": camera["columns"], "rows": camera["rows"], "intrinsics": camera["intrinsics"]}
    display = {name: manifest["display"][name] for name in ("columns", "rows", "pitch_mm")}
    return write_calibration(
        path, display=display, camera={**lens, "covariance": [[0.0] * 9] * 9}, poses=poses, **changes
    )


def test_the_sessions_own_calibration_is_taken_over_and_kept_with_the_result(
    glass_session: Path, tmp_path: Path
) -> None:
    own = calibration_of(glass_session, glass_session / "calibration.json", created="2018-01-01T12:00:00Z")
    try:
        metrics = run_session(glass_session, tmp_path / "own", Settings(method="paper"))
    finally:
        saved = own.read_bytes()
        own.unlink()
    assert any("151 days old" in warning for warning in metrics.warnings)
    assert "calibration.json" in metrics.hashes
    assert (tmp_path / "own" / "calibration.json").read_bytes() == saved
    assert 'href="calibration.html"' in (tmp_path / "own" / "report.html").read_text()
    assert "Geometric calibration" in (tmp_path / "own" / "calibration.html").read_text()
    # It says what the manifest said, so the points are the same to rounding.
    run_session(glass_session, tmp_path / "without", Settings(method="paper"))
    assert "No calibration was used" in (tmp_path / "without" / "report.html").read_text()
    assert not (tmp_path / "without" / "calibration.html").exists()
    calibrated, plain = (load_maps(tmp_path / name / "maps.npz") for name in ("own", "without"))
    assert np.allclose(calibrated.point_mm, plain.point_mm, atol=1e-9, equal_nan=True)


def test_the_slip_of_one_set_is_taken_over_from_a_calibration_that_is_given(
    glass_session: Path, tmp_path: Path
) -> None:
    given = calibration_of(glass_session, tmp_path / "other.json")
    fields = json.loads(given.read_text())
    far = fields["poses"]["pos1_air"]["centre_mm"]
    fields["poses"]["pos1_liquid"] = {"centre_mm": [0.3, *far[1:]], **STRAIGHT}
    given.write_text(json.dumps(fields))
    run_session(glass_session, tmp_path / "out", Settings(method="paper", calibration=given))
    kept = Manifest.model_validate_json((tmp_path / "out" / "manifest.json").read_text())
    assert kept.pose_of(kept.set_named("pos1_liquid")).centre_mm == (0.3, 0, far[2] - 60)
    assert kept.pose_of(kept.set_named("pos1_air")).centre_mm == (0, 0, far[2] - 60)


def test_a_session_in_scene_units_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    import_folder(DATA / "hard", folder, read_layout(DATA / "hard.toml"))
    given = calibration_of(folder, tmp_path / "other.json")
    with pytest.raises(CalibrationError, match="the session in scene units"):
        run_session(folder, tmp_path / "out", Settings(method="paper", calibration=given))


def test_another_rigs_calibration_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    session = write_session(tmp_path / "session")
    other = write_calibration(tmp_path / "other.json", display={"columns": 9, "rows": 9, "pitch_mm": 1.0})
    with pytest.raises(CalibrationError, match="display have 9 x 9 px, the session's 5 x 5"):
        run_session(session, tmp_path / "out", Settings(method="paper", threads=1, calibration=other))
    assert not (tmp_path / "out").exists()
