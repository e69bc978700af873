"""``rig calibrate response`` on a simulated display whose gamma, latency and flicker are known."""

import hashlib
import json
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from recon.calibration.response_record import ResponseRecord, read_response
from rig.calibrating.calibration_devices import CameraAndDisplay
from rig.calibrating.calibration_folder import CalibrationFolder
from rig.calibrating.response_capture import ResponseCapture
from rig.cli import main
from rig.config import RigConfig
from rig.devices import simulated_devices
from rig.errors import CaptureError
from rig.rehearsing.rehearsal import Simulation, open_world
from rig.rehearsing.scene_config import SceneOptions, config_of_scene
from sim_backend.photography import Photographer
from sim_backend.scene import Scene, load_scene

GAMMA, LATENCY_S, FREQUENCY_HZ, DEPTH, READOUT_S = 2.2, 0.12, 240.0, 0.3, 0.02
SHUTTERS = {"global": 0.0, "rolling": READOUT_S}


def late_scene(shutter: str, **display: object) -> Scene:
    scene = load_scene("semi_ellipsoid").resized(camera_columns=96, display_columns=64)
    behaviour = {
        "gamma": GAMMA,
        "latency_s": LATENCY_S,
        "flicker": {"frequency_hz": FREQUENCY_HZ, "depth": DEPTH},
        "drift_per_min": -0.004,
    }
    sensor = {"shutter": shutter, "readout_s": SHUTTERS[shutter]}
    return Scene.model_validate(
        scene.model_dump()
        | {"display": scene.display.model_dump() | behaviour | display, "camera": scene.camera.model_dump() | sensor}
    )


def measured(scene: Scene, folder: Path, *, config: RigConfig | None = None) -> tuple[ResponseRecord, list[str]]:
    said: list[str] = []
    config = config or config_of_scene(scene, SceneOptions())
    with open_world(config, Simulation(scene)) as world, CalibrationFolder(folder, "response") as kept:
        rig = simulated_devices(config, world, Photographer(scene))
        devices = CameraAndDisplay(rig.camera, rig.display, rig.clock)
        with devices.camera, devices.display:
            return ResponseCapture(devices, config, kept, said.append).run(minutes=5.0), said


@pytest.fixture(scope="module", params=["global", "rolling"])
def late(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ResponseRecord, Path]:
    folder = tmp_path_factory.mktemp(request.param)
    found, _ = measured(late_scene(request.param), folder)
    return request.param, found, folder


def test_a_gamma_of_2_2_is_measured(late: tuple[str, ResponseRecord, Path]) -> None:
    levels = late[1].levels
    assert levels is not None
    assert abs(levels.gamma - GAMMA) < 4 * levels.gamma_sd + 0.001
    assert levels.gamma_sd < 0.005
    np.testing.assert_allclose(levels.light_table, (np.arange(256) / 255) ** GAMMA, atol=0.003)


def test_a_latency_of_120_ms_is_measured(late: tuple[str, ResponseRecord, Path]) -> None:
    """From the command to the light; the simulated display says after 30 ms that it is done."""
    shutter, found, _ = late
    assert found.latency is not None
    assert abs(found.latency.latency_s - LATENCY_S) < 4 * found.latency.latency_sd_s
    assert found.latency.latency_sd_s < 0.002
    assert found.latency.acknowledged_s == pytest.approx(0.03, abs=1e-6)
    assert abs(found.latency.readout_s - SHUTTERS[shutter]) < 4 * found.latency.readout_sd_s


def test_a_flicker_of_240_hz_is_measured(late: tuple[str, ResponseRecord, Path]) -> None:
    flicker = late[1].flicker
    assert flicker is not None
    assert flicker.frequency_hz is not None
    assert flicker.frequency_sd_hz is not None
    assert abs(flicker.frequency_hz - FREQUENCY_HZ) < 4 * flicker.frequency_sd_hz
    assert flicker.frequency_sd_hz < 2
    assert abs(flicker.depth - DEPTH) < 4 * flicker.depth_sd


def test_bands_of_a_rolling_shutter_give_the_frequency_again(late: tuple[str, ResponseRecord, Path]) -> None:
    shutter, found, _ = late
    assert found.flicker is not None
    if shutter == "global":
        assert found.flicker.bands_per_photo is None
        return
    assert found.flicker.bands_per_photo == pytest.approx(FREQUENCY_HZ * READOUT_S, abs=0.05)


def test_a_drift_of_four_thousandths_a_minute_is_measured(late: tuple[str, ResponseRecord, Path]) -> None:
    """Brightness falls by 0.4 % of its first value each minute, a share of its mean that is larger by what was lost so far."""
    drift = late[1].drift
    assert drift is not None
    minutes = drift.time_s[len(drift.time_s) // 2] / 60
    assert abs(drift.per_min + 0.004 / (1 - 0.004 * minutes)) < 4 * drift.per_min_sd


def test_every_photo_is_kept_with_its_hash(late: tuple[str, ResponseRecord, Path]) -> None:
    _, found, folder = late
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    assert [line["file"] for line in lines] == [photo.file for photo in found.photos]
    assert len(lines) > 200
    for photo in found.photos:
        assert hashlib.sha256((folder / photo.file).read_bytes()).hexdigest() == photo.sha256


def test_a_display_later_than_the_settle_time_is_told_with_its_remedy(tmp_path: Path) -> None:
    _, said = measured(late_scene("global", latency_s=0.3), tmp_path)
    assert any("would show the frame before: raise settle_s in section [timing] by" in line for line in said)


def test_a_display_that_is_not_in_sight_is_told_before_anything_is_measured(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="the camera does not see the display light up: point it at the display"):
        measured(late_scene("global", centre_mm=(900.0, 0.0, 0.0)), tmp_path)


def test_a_rig_without_a_camera_is_told_and_stage_and_pump_are_not_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (resources.files("rig") / "template.toml").read_text("utf-8")
    (tmp_path / "rig.toml").write_text(text.replace('display = "" ', 'display = "browser:127.0.0.1:0" '))
    monkeypatch.setattr(sys, "argv", ["rig", "calibrate", "response", "calibration"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    assert "no camera configured: name driver and address" in capfd.readouterr().err
    assert not (tmp_path / "calibration").exists()


def test_photos_of_an_earlier_calibration_are_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "photos" / "response").mkdir(parents=True)
    with pytest.raises(CaptureError, match="photos are never overwritten; choose a new folder"):
        CalibrationFolder(tmp_path, "response")


def test_the_command_measures_and_writes_numbers_and_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "calibration"
    arguments = ["calibrate", "response", str(folder), "--sim", "--size", "48", "--display-columns", "32"]
    monkeypatch.setattr(sys, "argv", ["rig", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    out = capfd.readouterr().out
    assert "the display is seen in " in out
    assert "every photo from" in out.lower()  # this scene's display is never late, and said so
    found = read_response(folder / "response.json")
    assert found.levels is not None
    assert found.levels.gamma == pytest.approx(1.0, abs=0.01)
    page = (folder / "response.html").read_text()
    assert "Levels to photo values" in page
    assert "Not a real rig" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
