"""Photos of a board in each set: asked for in the configuration, planned, taken, resumed, and the same from every simulator."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simplejpeg

from recon.sessions.session import open_session
from recon.sessions.wholeness import faults
from rig.capture_sections import BoardPhotos
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import open_devices
from rig.planning.plan import all_photos, plan_capture, set_name, set_order
from rig.planning.steps import StartSweep, TakePhoto
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session
from sim_backend.scene import Scene


def with_board(config: RigConfig, board: BoardPhotos) -> RigConfig:
    return RigConfig.model_validate(config.model_dump() | {"capture": config.capture.model_dump() | {"board": board}})


# The smallest display that a board fits: three squares of 20 device pixels, whose markers take 12.
SMALL = SceneOptions(camera_columns=32, display_columns=64, width_px=24, step_px=8, board=True)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return open_scene("semi_ellipsoid", SMALL)


@pytest.fixture(scope="module")
def config(scene: Scene) -> RigConfig:
    return config_of_scene(scene, replace(SMALL, board=False))


@pytest.fixture(scope="module")
def board_config(config: RigConfig) -> RigConfig:
    return with_board(config, BoardPhotos(squares_along=3))


def test_every_set_begins_with_photos_of_the_board_before_its_sweeps(config: RigConfig) -> None:
    plan = plan_capture(with_board(config, BoardPhotos(squares_along=3, photos=2)))
    for place in set_order(config):
        name = set_name(place)
        board = [n for n, step in enumerate(plan) if isinstance(step, TakePhoto) and step.key[:2] == (name, "board")]
        sweeps = [n for n, step in enumerate(plan) if isinstance(step, StartSweep) and step.set_name == name]
        assert len(board) == 2
        assert max(board) < min(sweeps)


def test_a_board_photo_that_is_there_is_not_taken_again(board_config: RigConfig) -> None:
    done = {
        photo.key for photo in all_photos(board_config) if photo.sweep == "board" and photo.set_name != "pos1_liquid"
    }
    left = [
        step for step in plan_capture(board_config, done=done) if isinstance(step, TakePhoto) and step.sweep == "board"
    ]
    assert [photo.set_name for photo in left] == ["pos1_liquid"]


def test_a_capture_through_devices_and_a_simulation_show_the_same_board(
    tmp_path: Path, board_config, scene, quiet, read_photo_bytes
) -> None:
    simulate_session(scene, board_config, tmp_path / "straight", workers=1, console=quiet)
    with open_devices(board_config, simulation=Simulation(scene)) as devices:
        capture(board_config, tmp_path / "devices", devices=devices, scene=scene, resume=False, console=quiet)
    photos = read_photo_bytes(tmp_path / "devices")
    assert photos == read_photo_bytes(tmp_path / "straight")
    session = open_session(tmp_path / "devices")
    assert not [fault for fault in faults(session) if not fault.is_warning]
    board = session.manifest.board
    assert board is not None
    assert (board.squares_x, board.squares_y, board.square_px, board.first_column) == (3, 3, 20, 2)
    # Beside the object the board is as bright as white and as dark as black, half of it each.
    shown, white = (
        simplejpeg.decode_jpeg(photos[f"photos/pos0_air/{name}.jpg"], "GRAY")[..., 0].astype(float)
        for name in ("board_0000", "white")
    )
    assert 0.2 < np.mean(shown) / np.mean(white) < 0.8


def test_a_board_that_does_not_fit_the_display_is_refused_with_what_to_ask_for(config: RigConfig) -> None:
    with pytest.raises(ValueError, match=r"capture\.board: .* ask for fewer squares"):
        with_board(config, BoardPhotos(squares_along=16))


def test_a_thin_object_has_no_wet_set_to_compare(thin_config: RigConfig) -> None:
    with pytest.raises(ValueError, match=r"capture\.board belongs to method 'liquid'"):
        with_board(thin_config, BoardPhotos(squares_along=3))
