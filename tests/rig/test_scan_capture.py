"""A scan at the beginning of each set: fewer photos, found again on resuming, and the surface of a full sweep."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from recon.run import decode_session
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.session import TRUTH_NAME, open_session
from recon.sessions.wholeness import faults
from rig.capturing.capture import capture
from rig.devices import Devices, open_devices
from rig.errors import CaptureError, CaptureStopped
from rig.planning.plan import all_photos, plan_capture
from rig.planning.steps import FindSweptRange, StartSweep, TakePhoto
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session

# 90 × 90 photos, 128 by 96 stripe places: the hemisphere's camera sees about half of the panel each way.
SIZE = SceneOptions(camera_columns=90, display_columns=256, width_px=8, step_px=2)
OPTIONS = dataclasses.replace(SIZE, scan=True)


@pytest.fixture(scope="module")
def hemisphere():
    scene = open_scene("hemisphere", OPTIONS)
    return scene, config_of_scene(scene, OPTIONS)


def take(folder: Path, config, scene, *, resume: bool = False, break_at: int | None = None) -> None:
    """Capture with simulated devices; ``break_at`` is the photo of this run at which somebody interrupts twice."""
    with open_devices(config, simulation=Simulation(scene)) as devices:
        if break_at is not None:
            interrupted_at(devices, break_at)
        capture(config, folder, devices=devices, scene=scene, resume=resume, console=Console(quiet=True))


def interrupted_at(devices: Devices, number: int) -> None:
    collect = devices.camera.collect
    calls = iter(range(10**9))

    def call(**arguments: Any) -> Any:
        if next(calls) == number:
            raise KeyboardInterrupt
        return collect(**arguments)

    devices.camera.collect = call  # type: ignore[method-assign]


@pytest.fixture(scope="module")
def scanned(hemisphere, tmp_path_factory) -> Path:
    scene, config = hemisphere
    folder = tmp_path_factory.mktemp("scanned") / "session"
    take(folder, config, scene)
    return folder


def test_a_plan_scans_each_set_before_its_sweeps_and_counts_every_photo_that_may_be_needed(hemisphere) -> None:
    _, config = hemisphere
    plan = plan_capture(config)
    for name in ("pos0_air", "pos1_air", "pos0_liquid", "pos1_liquid"):
        steps = [step for step in plan if getattr(step, "set_name", "") == name]
        finds = steps.index(FindSweptRange(name))
        assert {step.sweep for step in steps[:finds] if isinstance(step, TakePhoto)} == {
            "white",
            "black",
            "scan_x",
            "scan_y",
        }
        assert isinstance(steps[finds + 1], StartSweep)
        assert {step.sweep for step in steps[finds:] if isinstance(step, TakePhoto)} == {"x", "y"}


def test_only_what_is_seen_is_photographed_and_the_session_is_sound(hemisphere, scanned: Path) -> None:
    _, config = hemisphere
    session = open_session(scanned)
    assert [str(fault) for fault in faults(session) if not fault.is_warning] == []
    assert len(session.ranges) == 8
    assert len(session.photos) == len(all_photos(config, session.ranges))
    assert len(session.photos) < 0.75 * len(all_photos(config))
    numbers = {photo.key: photo.frame_id for photo in all_photos(config)}
    assert all(record.device["frame_id"] == numbers[key] for key, record in session.photos.items())


@pytest.fixture(scope="module")
def swept_whole(tmp_path_factory) -> Path:
    scene = open_scene("hemisphere", SIZE)
    folder = tmp_path_factory.mktemp("whole") / "session"
    simulate_session(scene, config_of_scene(scene, SIZE), folder, workers=1, console=Console(quiet=True))
    return folder


def test_the_surface_is_that_of_the_full_sweep(scanned: Path, swept_whole: Path) -> None:
    maps = {}
    for name, folder in (("part", scanned), ("whole", swept_whole)):
        session = open_session(folder)
        maps[name] = reconstruct(session, decode_session(session, Settings(threads=1)), Settings()).maps
    with np.load(swept_whole / TRUTH_NAME) as truth:
        on_object = np.isfinite(truth["point_mm"]).all(axis=2)
    part, whole = maps["part"].valid() & on_object, maps["whole"].valid() & on_object
    assert whole.sum() > 1000
    # As complete: to half a per cent of the object's pixels.
    assert abs(int(part.sum()) - int(whole.sum())) <= 0.005 * on_object.sum()
    both = part & whole
    apart_mm = np.linalg.norm(maps["part"].point_mm[both] - maps["whole"].point_mm[both], axis=1)
    # And the same points: apart by a small part of what each of them is uncertain by.
    assert np.median(apart_mm / maps["whole"].sd_mm[both]) < 0.1


# While the first set is scanned, just after its ranges were found, and in the middle of everything.
@pytest.mark.parametrize("number", [3, 11, 300])
def test_an_interrupted_scan_is_resumed_to_the_same_photos(
    hemisphere, scanned: Path, tmp_path: Path, number: int
) -> None:
    scene, config = hemisphere
    folder = tmp_path / "session"
    with pytest.raises(CaptureStopped, match="stopped with"):
        take(folder, config, scene, break_at=number)
    take(folder, config, scene, resume=True)
    ours, theirs = open_session(folder), open_session(scanned)
    assert {key: record.sha256 for key, record in ours.photos.items()} == {
        key: record.sha256 for key, record in theirs.photos.items()
    }
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    assert sum(line["event"] == "sweep_range" for line in lines) == 8


def test_a_scan_that_sees_nothing_says_where_to_look_before_a_single_sweep(hemisphere, tmp_path: Path) -> None:
    scene, config = hemisphere
    dark = scene.model_copy(update={"camera": scene.camera.model_copy(update={"signal": 0.001})})
    with pytest.raises(CaptureError, match=r"scan of pos0_air along x: no pixel of the photos sees the swept area"):
        take(tmp_path / "session", config, dark)
    assert not [key for key in open_session(tmp_path / "session").photos if key[1] in ("x", "y")]


def test_a_region_of_the_photo_narrows_the_sweep_to_what_is_seen_there(
    hemisphere, scanned: Path, tmp_path: Path
) -> None:
    scene, config = hemisphere
    region = config.capture.model_copy(
        update={"scan": config.capture.scan.model_copy(update={"seen_px": (35, 35, 55, 55)})}
    )
    take(tmp_path / "session", config.model_copy(update={"capture": region}), scene)
    part, whole = open_session(tmp_path / "session"), open_session(scanned)
    assert len(part.photos) < len(whole.photos)
