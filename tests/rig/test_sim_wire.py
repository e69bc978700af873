"""Whole captures through the real drivers, on emulated devices that share one world with the page in Chromium."""

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import rig.devices
from drivers.errors import DeviceError, DeviceNotFoundError
from drivers.protocols import Frame
from recon.sessions.session import open_session
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import open_devices
from rig.rehearsing.emulation import EmulatedRig, emulate_rig
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.browser_tablet import BrowserTablet
from sim_backend.chromium import Chromium
from sim_backend.scene import Scene
from sim_backend.world import World

OPTIONS = SceneOptions(camera_columns=32, display_columns=48, width_px=16.0, step_px=20.0)
# So fast that a fill is watched a hundred times and not a thousand times.
RATE_ML_PER_MIN = 9000.0
Behind = list[tuple[World, EmulatedRig]]


@pytest.fixture
def behind(monkeypatch: pytest.MonkeyPatch, require_program: Callable[[str, str], str]) -> Behind:
    """What stands behind the drivers, for a test to look at and to spoil."""
    require_program("chromium", "chromium")
    seen: Behind = []

    @contextmanager
    def watched(config: RigConfig, world: World, optics: Any, **times_s: float) -> Iterator[EmulatedRig]:
        with emulate_rig(config, world, optics, **times_s) as emulated:
            seen.append((world, emulated))
            yield emulated

    monkeypatch.setattr(rig.devices, "emulate_rig", watched)
    return seen


def wet_rig() -> tuple[RigConfig, Scene]:
    scene = open_scene("semi_ellipsoid", OPTIONS)
    config = config_of_scene(scene, OPTIONS)
    assert config.tank is not None
    tank = config.tank.model_copy(update={"pump_rate_ml_per_min": RATE_ML_PER_MIN})
    return config.model_copy(update={"tank": tank}), scene


def run(config: RigConfig, scene: Scene, folder: Path, quiet: Any, *, wire: bool) -> list[dict[str, Any]]:
    with open_devices(config, simulation=Simulation(scene, wire=wire)) as devices:
        capture(config, folder, devices=devices, scene=scene, resume=False, console=quiet)
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()]


def pictures(folder: Path) -> dict[str, np.ndarray]:
    found = {}
    for path in sorted(folder.glob("photos/**/*.jpg")):
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert picture is not None
        found[path.relative_to(folder).as_posix()] = picture
    return found


def assert_same_pictures(found: Path, wanted: Path) -> None:
    theirs, ours = pictures(found), pictures(wanted)
    assert list(theirs) == list(ours)
    for name, picture in ours.items():
        np.testing.assert_array_equal(theirs[name], picture, err_msg=name)


def test_a_session_through_the_real_drivers_is_that_of_the_simulated_devices(
    behind: Behind, quiet: Any, tmp_path: Path
) -> None:
    config, scene = wet_rig()
    journal = run(config, scene, tmp_path / "wire", quiet, wire=True)
    simulated_journal = run(config, scene, tmp_path / "simulated", quiet, wire=False)
    ((world, _),) = behind
    assert world.disturbed_photos == 0
    assert world.state().tank_ml == pytest.approx(0.0, abs=1.0)  # the pump takes four digits of volume
    assert world.state().overflow_ml == 0

    # Light and noise are a function of what is shown and where: the only path to them is through every driver.
    assert_same_pictures(tmp_path / "wire", tmp_path / "simulated")
    assert [entry["event"] for entry in journal] == [entry["event"] for entry in simulated_journal]

    found, wanted = (open_session(tmp_path / name).manifest.model_dump() for name in ("wire", "simulated"))
    devices = found["provenance"].pop("devices")
    del wanted["provenance"]["devices"], found["created"], wanted["created"]
    assert found == wanted
    assert {name: record["kind"] for name, record in devices.items()} == dict.fromkeys(
        ("camera", "display", "stage", "pump"), "emulated"
    )


def test_photos_that_the_camera_spoils_are_taken_again_through_the_driver(
    behind: Behind, quiet: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = open_scene("thin_cone", OPTIONS)
    config = config_of_scene(scene, OPTIONS)
    look = World.look
    photos = iter(range(10**6))

    def spoiling(world: World, **opened_on: Any) -> Any:
        number = next(photos)
        if number == 4:  # a damaged file is downloaded once more by the driver itself, so two are needed
            behind[0][1].camera.set_faults(truncated=2)
        if number == 9:
            behind[0][1].camera.set_faults(stale=1)
        return look(world, **opened_on)

    monkeypatch.setattr(World, "look", spoiling)
    journal = run(config, scene, tmp_path / "wire", quiet, wire=True)
    monkeypatch.undo()
    run(config, scene, tmp_path / "simulated", quiet, wire=False)
    reasons = [entry["reason"] for entry in journal if entry["event"] == "photo_spoiled"]
    assert len(reasons) == 2
    assert "byte for byte the photo before" in reasons[1]
    assert_same_pictures(tmp_path / "wire", tmp_path / "simulated")


def test_the_tablet_tells_what_its_screen_shows(require_program: Callable[[str, str], str]) -> None:
    require_program("chromium", "chromium")
    page = (
        "data:text/html,<body style='margin:0;background:linear-gradient(to right,%23000 0 20px,%23ff0000 20px)'>"
        "<div style='position:absolute;left:3px;top:5px;width:4px;height:2px;background:%23f00'>"
    )
    with Chromium() as chromium:
        tablet = BrowserTablet(chromium, columns=48, rows=30)
        tablet.open(page)
        deadline_s = time.monotonic() + 20.0
        frame = Frame()
        while not frame.patches and time.monotonic() < deadline_s:
            with contextlib.suppress(DeviceError):  # while one page gives way to the other, there is none
                frame = tablet.frame()
    assert frame.axis == "x"
    assert frame.levels is not None
    np.testing.assert_array_equal(frame.levels, [0] * 20 + [255] * 28)
    (patch,) = frame.patches
    assert (patch.column, patch.row, patch.levels.shape) == (3, 5, (2, 4))
    assert (patch.levels == 255).all()


def test_without_chromium_one_sentence_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    config, scene = wet_rig()
    monkeypatch.setenv("PATH", str(tmp_path))
    with (
        pytest.raises(DeviceNotFoundError, match=r"Chromium.*is not installed; on Debian: apt-get install chromium"),
        open_devices(config, simulation=Simulation(scene, wire=True)),
    ):
        pass


def test_a_chromium_that_does_not_start_is_named_with_the_way_to_see_why(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    broken = tmp_path / "chromium"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(DeviceNotFoundError, match=r"does not start; `.*/chromium --headless=new .* tells why"):
        Chromium().__enter__()
