"""``rig simulate``: the photos of a simulated capture, straight from the optics."""

from pathlib import Path

import numpy as np
import pytest

from recon.sessions.session import open_session
from rig.capturing.capture import capture
from rig.devices import open_devices
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session


def test_a_capture_through_devices_and_a_simulation_are_equal_to_the_byte(
    tmp_path: Path, config, scene, quiet, captured, read_photo_bytes
) -> None:
    simulate_session(scene, config, tmp_path / "session", workers=2, console=quiet)
    assert read_photo_bytes(tmp_path / "session") == read_photo_bytes(captured)
    first, second = (open_session(folder).manifest for folder in (tmp_path / "session", captured))
    assert first.model_dump(exclude={"created", "provenance"}) == second.model_dump(exclude={"created", "provenance"})
    assert first.provenance.configuration == second.provenance.configuration


@pytest.mark.parametrize("order", ["one_fill", "paper"])
def test_a_thin_object_is_photographed_with_and_without_to_the_same_bytes(
    tmp_path: Path, quiet, read_photo_bytes, order
) -> None:
    options = SceneOptions(camera_columns=24, display_columns=32, step_px=8.0, order=order)
    scene = open_scene("thin_cone", options)
    config = config_of_scene(scene, options)
    simulate_session(scene, config, tmp_path / "straight", workers=1, console=quiet)
    with open_devices(config, simulation=Simulation(scene)) as devices:
        capture(config, tmp_path / "devices", devices=devices, scene=scene, resume=False, console=quiet)
    photos = read_photo_bytes(tmp_path / "straight")
    assert photos == read_photo_bytes(tmp_path / "devices")
    assert photos["photos/pos0_with/white.jpg"] != photos["photos/pos0_without/white.jpg"]


def test_the_number_of_workers_does_not_change_a_byte(tmp_path: Path, config, scene, quiet, captured, read_photo_bytes):
    simulate_session(scene, config, tmp_path / "session", workers=5, console=quiet)
    assert read_photo_bytes(tmp_path / "session") == read_photo_bytes(captured)


def test_the_truth_lies_beside_the_session_on_the_cameras_grid(tmp_path: Path, config, scene, quiet) -> None:
    simulate_session(scene, config, tmp_path / "session", workers=2, console=quiet)
    with np.load(tmp_path / "session/truth.npz") as truth:
        assert truth["point_mm"].shape == truth["normal"].shape == (32, 32, 3)
        judged = truth["status"] == 0
        # The semi-ellipsoid x²/12.5² + y²/12.5² + z²/5² = 1
        x, y, z = truth["point_mm"][judged].T
    assert judged.any()
    np.testing.assert_allclose((x / 12.5) ** 2 + (y / 12.5) ** 2 + (z / 5) ** 2, 1, atol=1e-9)


def test_the_session_says_that_it_is_simulated(tmp_path: Path, config, scene, quiet) -> None:
    simulate_session(scene, config, tmp_path / "session", workers=2, console=quiet)
    manifest = open_session(tmp_path / "session").manifest
    assert {record.kind for record in manifest.provenance.devices.values()} == {"simulated"}
    assert manifest.display_poses[0].centre_mm[2] == scene.stage_positions_mm[0]
    assert manifest.camera.pose is not None
