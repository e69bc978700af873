"""Captures that ended because of something, were resumed on the same rig when it was mended, and lost nothing by it.

The world goes on between the two commands: tank and stage are as the first one left them, and the devices are opened anew.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import DeviceError, DeviceNotFoundError, DeviceTimeoutError
from drivers.protocols import PumpStatus
from recon.sessions.session import open_session
from rig.capturing.capture import capture
from rig.devices import Devices, simulated_devices
from rig.errors import CaptureError
from rig.rehearsing.rehearsal import Simulation, open_world
from sim_backend.photography import Photographer
from sim_backend.world import World

Break = Callable[[Devices, World], tuple[Any, str, Any]]


def from_call(number: int, method: Any, *, fails: Any) -> Any:
    """Let a method work ``number`` times and never again."""
    calls = iter(range(10**9))

    def call(*args: Any, **kwargs: Any) -> Any:
        if next(calls) < number:
            return method(*args, **kwargs)
        return fails()

    return call


def raises(error: Exception) -> Any:
    def fail() -> None:
        raise error

    return fail


def camera_unplugged(devices: Devices, world: World) -> tuple[Any, str, Any]:  # noqa: ARG001  (as all that breaks)
    gone = raises(DeviceNotFoundError("camera: gone from USB; plug it in"))
    return devices.camera, "expose", from_call(40, devices.camera.expose, fails=gone)


def camera_dies_in_the_download(devices: Devices, world: World) -> tuple[Any, str, Any]:  # noqa: ARG001
    gone = raises(DeviceTimeoutError("camera: battery empty"))
    return devices.camera, "collect", from_call(17, devices.camera.collect, fails=gone)


def tablet_asleep(devices: Devices, world: World) -> tuple[Any, str, Any]:  # noqa: ARG001
    asleep = raises(DeviceError("display: the tablet sleeps; wake it"))
    return devices.display, "show", from_call(55, devices.display.show, fails=asleep)


def leak_between_two_photos(devices: Devices, world: World) -> tuple[Any, str, Any]:
    assert devices.pump is not None
    leak = PumpStatus(False, None, 0.0, alarm="the leak sensor is wet")
    status = devices.pump.status
    return devices.pump, "status", lambda: leak if world.is_wet() else status()


def pump_alarm_in_mid_fill(devices: Devices, world: World) -> tuple[Any, str, Any]:
    assert devices.pump is not None
    status = devices.pump.status

    def stalls_when_half_is_in() -> PumpStatus:
        if world.state().tank_ml > 1000:
            world.stop_flow()
            return PumpStatus(False, None, world.moved_ml(), alarm="the motor stalled")
        return status()

    return devices.pump, "status", stalls_when_half_is_in


def stage_silent_in_mid_move(devices: Devices, world: World) -> tuple[Any, str, Any]:
    def stuck() -> None:
        world.start_motion(3.0, velocity_mm_per_s=5.0)
        world.clock.sleep_s(0.5)
        world.stop_motion()
        world.set_homed(False)
        raise DeviceTimeoutError("stage: silent")

    return devices.stage, "move_to_mm", from_call(1, devices.stage.move_to_mm, fails=stuck)


@pytest.mark.parametrize(
    ("breaks", "has_to_look"),
    [
        (camera_unplugged, False),
        (camera_dies_in_the_download, False),
        (tablet_asleep, False),
        (leak_between_two_photos, True),
        (pump_alarm_in_mid_fill, True),
        (stage_silent_in_mid_move, True),
    ],
)
def test_a_capture_that_ended_is_resumed_to_the_same_bytes_once_it_is_mended(
    breaks: Break, has_to_look: bool, config, scene, quiet, tmp_path: Path, captured: Path, read_photo_bytes
) -> None:
    folder = tmp_path / "session"
    photographer = Photographer(scene)
    shutter: list[int | None] = []
    with open_world(config, Simulation(scene)) as world:
        look = world.look

        def counted(**seen: Any) -> Any:
            sight = look(**seen)
            shutter.append(sight.frame_id)
            return sight

        world.look = counted  # type: ignore[method-assign]
        devices = simulated_devices(config, world, photographer)
        device, method, broken = breaks(devices, world)
        setattr(device, method, broken)
        with pytest.raises((DeviceError, CaptureError)) as ended:
            capture(config, folder, devices=devices, scene=scene, resume=False, console=quiet)
        assert "\n" not in str(ended.value)
        assert world.flow_direction() is None
        assert not world.is_moving()
        done = set(open_session(folder).photos)
        taken_before = len(shutter)
        assert 0 < len(done) < 72

        mended = simulated_devices(config, world, photographer)
        if has_to_look:
            with pytest.raises(CaptureError, match="resume with --checked"):
                capture(config, folder, devices=mended, scene=scene, resume=True, console=quiet)
            assert len(shutter) == taken_before
        result = capture(config, folder, devices=mended, scene=scene, resume=True, console=quiet, checked=has_to_look)
        assert world.disturbed_photos == 0
        assert world.state().overflow_ml == 0
    assert result.photos_taken == 72 - len(done)
    frames_of_done = {
        entry["device"]["frame_id"]
        for entry in map(json.loads, (folder / "journal.jsonl").read_text().splitlines())
        if entry["event"] == "photo" and (entry["set"], entry["sweep"], entry["index"]) in done
    }
    assert frames_of_done.isdisjoint(shutter[taken_before:])  # a good photo is never shot twice
    assert read_photo_bytes(folder) == read_photo_bytes(captured)
