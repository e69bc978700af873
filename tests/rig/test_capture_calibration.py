"""A capture takes its calibration over, says where it comes from, and refuses one that is of another rig."""

import hashlib
import sys
from pathlib import Path

import pytest
from rich.console import Console

from recon.calibration.calibration_file import CalibratedCamera, Calibration, Quality, write_calibration
from recon.calibration.errors import CalibrationError
from recon.calibration.response_record import ResponseRecord, write_response
from recon.sessions.manifest import Pose
from recon.sessions.session import open_session
from rig.calibrating.session_calibration import with_calibration_of
from rig.capture_sections import PhaseShiftCode
from rig.capturing.capture import capture
from rig.capturing.session_manifest import manifest_of
from rig.cli import main
from rig.config import RigConfig
from sim_backend.scene import Scene

CREATED = "2026-01-02T03:04:05+00:00"
NEAR = Pose(centre_mm=(0.5, 0.0, 70.0), x_axis=(1.0, 0.0, 0.0), y_axis=(0.0, 1.0, 0.0))
FAR = Pose(centre_mm=(0.5, 0.0, 80.0), x_axis=(1.0, 0.0, 0.0), y_axis=(0.0, 1.0, 0.0))


def calibration_of(config: RigConfig, **camera: object) -> Calibration:
    assert config.camera.intrinsics is not None
    measured = CalibratedCamera.model_validate(
        {
            "columns": config.camera.columns,
            "rows": config.camera.rows,
            "intrinsics": config.camera.intrinsics.model_copy(update={"focal_x_px": 80.0}),
            "covariance": [[0.0] * 9] * 9,
        }
        | camera
    )
    return Calibration(
        schema_version=1,
        created=CREATED,
        display=config.display,
        camera=measured,
        poses={"pos0_air": NEAR, "pos1_air": FAR},
        quality=Quality(reprojection_rms_px=0.1, corner_sd_px=0.1),
    )


@pytest.fixture
def in_mm(config: RigConfig) -> RigConfig:
    return config.model_copy(update={"length_unit": "mm"})


@pytest.fixture
def file(tmp_path: Path, in_mm: RigConfig) -> Path:
    path = tmp_path / "calibration.json"
    write_calibration(path, calibration_of(in_mm))
    return path


def test_a_capture_writes_the_measured_poses_and_where_they_come_from(
    tmp_path: Path, in_mm: RigConfig, scene: Scene, file: Path, open_bench, capfd: pytest.CaptureFixture[str]
) -> None:
    """The camera of this scene is at z = -60 and looks along z: what is 70 mm before it is at z = 10."""
    config = in_mm.model_copy(update={"calibration": str(file)})
    with open_bench(config, scene) as (devices, _):
        capture(config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=Console(width=400))
    manifest = open_session(tmp_path / "s").manifest
    assert manifest.display_poses[0].centre_mm == pytest.approx((0.5, 0.0, 10.0))
    assert manifest.display_poses[1].centre_mm == pytest.approx((0.5, 0.0, 20.0))
    assert manifest.camera.intrinsics is not None
    assert manifest.camera.intrinsics.focal_x_px == 80.0
    source = manifest.provenance.configuration["calibration"]
    assert source == {
        "file": str(file),
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "created": CREATED,
    }
    assert "warning:" in capfd.readouterr().out  # it is older than it holds for


def test_a_calibration_of_another_photo_size_is_refused(tmp_path: Path, in_mm: RigConfig, scene: Scene) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(path, calibration_of(in_mm, columns=640))
    with pytest.raises(CalibrationError, match="the calibration's photos have 640 x 32 px, the session's 32 x 32"):
        with_calibration_of(manifest_of(in_mm, devices={}, scene=scene), str(path))


def test_a_response_beside_the_calibration_is_named_and_its_other_settings_are_told(
    in_mm: RigConfig, scene: Scene, file: Path
) -> None:
    response = ResponseRecord(
        schema_version=1, name="r", created=CREATED, display=in_mm.display, settings={"shutter": "1/60"}
    )
    write_response(file.with_name("response.json"), response)
    camera = in_mm.camera.model_copy(update={"settings": {"shutter": "1/4"}})
    config = in_mm.model_copy(update={"camera": camera})
    manifest, doubts = with_calibration_of(manifest_of(config, devices={}, scene=scene), str(file))
    assert any("the response was measured with shutter 1/60, this capture has 1/4" in doubt for doubt in doubts)
    source = manifest.provenance.configuration["calibration"]
    assert isinstance(source, dict)
    assert source["response"]["created"] == CREATED


def test_a_capture_of_fringes_keeps_the_response_that_they_are_read_with(
    tmp_path: Path, in_mm: RigConfig, scene: Scene, file: Path, open_bench
) -> None:
    response = ResponseRecord(schema_version=1, name="r", created=CREATED, display=in_mm.display)
    write_response(file.with_name("response.json"), response)
    fringes = in_mm.capture.model_copy(update={"code": PhaseShiftCode(kind="phase_shift", finest_period_px=8.0)})
    config = in_mm.model_copy(update={"calibration": str(file), "capture": fringes})
    with open_bench(config, scene) as (devices, _):
        capture(config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=Console(width=400))
    assert (tmp_path / "s" / "response.json").read_bytes() == file.with_name("response.json").read_bytes()


def test_without_a_calibration_the_manifest_stays_as_configured(config: RigConfig, scene: Scene) -> None:
    manifest = manifest_of(config, devices={}, scene=scene)
    assert with_calibration_of(manifest, None) == (manifest, ())


def test_a_calibration_that_is_not_there_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["rig", "calibrate", "check", str(tmp_path / "none.json"), "--sim"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    assert "none.json: no such calibration" in capfd.readouterr().err
