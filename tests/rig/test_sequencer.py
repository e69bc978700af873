"""Running a plan on devices: interlocks, intent before action, and coming to rest whatever happens."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from drivers.errors import DeviceBusyError, DeviceError, DeviceProtocolError, DeviceTimeoutError
from drivers.protocols import Photo, PumpStatus
from recon.sessions.session import open_session
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import open_devices
from rig.errors import CaptureError, CaptureStopped, InterlockError
from rig.planning.plan import all_photos
from rig.rehearsing.rehearsal import Simulation
from sim_backend.world import WorldState


def journal_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


def events_of(folder: Path) -> list[str]:
    return [entry["event"] for entry in journal_of(folder)]


class Wrapped:
    """A device with some of its methods replaced."""

    def __init__(self, device: Any, **methods: Any) -> None:
        self._device = device
        self.__dict__.update(methods)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)


def fails_at(number: int, method: Any, error: BaseException) -> Any:
    calls = iter(range(10**9))

    def call(*args: Any, **kwargs: Any) -> Any:
        if next(calls) == number:
            raise error
        return method(*args, **kwargs)

    return call


def fails_from(number: int, method: Any, error: BaseException) -> Any:
    calls = iter(range(10**9))

    def call(*args: Any, **kwargs: Any) -> Any:
        if next(calls) >= number:
            raise error
        return method(*args, **kwargs)

    return call


def impatient(config: RigConfig) -> RigConfig:
    """A rig that gives up soon on what is away."""
    return config.model_copy(update={"timing": config.timing.model_copy(update={"longest_suspension_s": 3.0})})


def test_a_capture_takes_every_photo_of_a_rig_at_rest(
    open_bench, config, scene, quiet, tmp_path, read_photo_bytes
) -> None:
    folder = tmp_path / "session"
    with open_bench(config, scene) as (devices, world):
        result = capture(config, folder, devices=devices, scene=scene, resume=False, console=quiet)
        assert world.disturbed_photos == 0
        assert world.state().overflow_ml == 0
        assert world.state().tank_ml == 0
    session = open_session(folder)
    assert set(session.photos) == {photo.key for photo in all_photos(config)}
    assert result.photos_taken == result.photos_needed == len(read_photo_bytes(folder)) == 72
    assert {record.kind for record in session.manifest.provenance.devices.values()} == {"simulated"}
    assert set(session.manifest.provenance.devices) == {"camera", "display", "stage", "pump", "level_sensor"}


def test_a_thin_object_is_put_in_once_and_the_rig_needs_no_pump(
    open_bench, thin_config, thin_scene, quiet, tmp_path
) -> None:
    folder = tmp_path / "session"
    with open_bench(thin_config, thin_scene) as (devices, world):
        assert devices.pump is None
        capture(thin_config, folder, devices=devices, scene=thin_scene, resume=False, console=quiet)
        assert world.state().object_present
    asked = [entry["request"] for entry in journal_of(folder) if entry["event"] == "operator_asked"]
    assert asked == ["remove_object", "insert_object"]
    assert "fill_started" not in events_of(folder)


def test_the_intent_to_pump_or_move_is_on_disk_before_the_action(open_bench, config, scene, quiet, tmp_path) -> None:
    folder = tmp_path / "session"
    last_events = []

    def after_reading_the_journal(method: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            last_events.append(events_of(folder)[-1])
            return method(*args, **kwargs)

        return call

    with open_bench(config, scene) as (devices, _):
        watched = dataclasses.replace(
            devices,
            pump=Wrapped(devices.pump, start=after_reading_the_journal(devices.pump.start)),
            stage=Wrapped(
                devices.stage,
                home=after_reading_the_journal(devices.stage.home),
                move_to_mm=after_reading_the_journal(devices.stage.move_to_mm),
            ),
        )
        capture(config, folder, devices=watched, scene=scene, resume=False, console=quiet)
    started = ["homing_started", "move_started", "move_started", "fill_started", "move_started", "drain_started"]
    assert last_events == started


@pytest.mark.parametrize("number", [0, 17, 40, 71])
def test_a_capture_that_lost_its_camera_is_resumed_to_the_same_bytes(
    open_bench, config, scene, quiet, tmp_path, captured, read_photo_bytes, number: int
) -> None:
    folder = tmp_path / "session"
    with open_bench(config, scene) as (devices, world):
        lost = DeviceTimeoutError("camera: gone")
        broken = dataclasses.replace(
            devices, camera=Wrapped(devices.camera, collect=fails_from(number, devices.camera.collect, lost))
        )
        with pytest.raises(DeviceTimeoutError, match="gone"):
            capture(impatient(config), folder, devices=broken, scene=scene, resume=False, console=quiet)
        assert world.flow_direction() is None
        assert not world.is_moving()
        assert events_of(folder)[-1] == "capture_failed"
        assert len(open_session(folder).photos) == number
    with open_bench(config, scene) as (devices, world):  # a new process: an empty tank, a stage that is not homed
        result = capture(config, folder, devices=devices, scene=scene, resume=True, console=quiet)
        assert world.disturbed_photos == 0
    assert result.photos_taken == 72 - number
    assert read_photo_bytes(folder) == read_photo_bytes(captured)


def test_resuming_believes_the_tank_and_not_the_journal(
    open_bench, config, scene, quiet, tmp_path, captured, read_photo_bytes
) -> None:
    folder = tmp_path / "session"
    with open_bench(config, scene) as (devices, world):
        lost = DeviceTimeoutError("camera: gone")
        broken = dataclasses.replace(
            devices, camera=Wrapped(devices.camera, collect=fails_from(40, devices.camera.collect, lost))
        )
        with pytest.raises(DeviceTimeoutError):
            capture(impatient(config), folder, devices=broken, scene=scene, resume=False, console=quiet)
        # The tank is still full. This time no second fill may start.
        assert world.state().tank_ml == pytest.approx(config.tank.fill_ml)
        with devices.camera:  # switched off and on: the photo that was lost is forgotten
            pass
        capture(config, folder, devices=devices, scene=scene, resume=True, console=quiet)
        assert world.state().overflow_ml == 0
    assert events_of(folder).count("fill_started") == 1
    assert read_photo_bytes(folder) == read_photo_bytes(captured)


def test_a_photo_that_was_damaged_on_disk_is_taken_again(
    open_bench, config, scene, quiet, tmp_path, captured, read_photo_bytes
) -> None:
    folder = tmp_path / "session"
    with open_bench(config, scene) as (devices, _):
        capture(config, folder, devices=devices, scene=scene, resume=False, console=quiet)
    (folder / "photos/pos0_air/x/0003.jpg").write_bytes(b"half a photo")
    (folder / "photos/pos1_liquid/white.jpg").unlink()
    with open_bench(config, scene) as (devices, _):
        result = capture(config, folder, devices=devices, scene=scene, resume=True, console=quiet)
    assert result.photos_taken == 2
    assert read_photo_bytes(folder) == read_photo_bytes(captured)


def test_a_fill_that_would_overflow_is_refused_before_anything_flows(
    open_bench, config, scene, quiet, tmp_path
) -> None:
    """The tank holds more than its sensor says when the capture starts; the ledger catches it before the fill."""
    with open_bench(config, scene) as (devices, world):
        readings = iter([0.0])
        sensor = Wrapped(devices.level_sensor, volume_ml=lambda: next(readings, 0.0))
        tank = config.tank.model_copy(update={"free_volume_ml": config.tank.fill_ml / 2})
        small = config.model_copy(update={"tank": tank})
        with pytest.raises(InterlockError, match="may hold"):
            capture(
                small,
                tmp_path / "session",
                devices=dataclasses.replace(devices, level_sensor=sensor),
                scene=scene,
                resume=False,
                console=quiet,
            )
        assert world.state().tank_ml == 0
    assert "fill_started" not in events_of(tmp_path / "session")


def test_a_reservoir_that_runs_dry_stops_the_capture_and_says_what_to_look_at(
    open_bench, config, scene, quiet, tmp_path
) -> None:
    with open_bench(config, scene) as (devices, world):
        world._state = WorldState(reservoir_ml=1000.0)
        with pytest.raises(
            CaptureError, match=r"sensor says .* 1000 ml, the ledger says 4\d{3} ml \(counted.*empty reservoir"
        ):
            capture(config, tmp_path / "session", devices=devices, scene=scene, resume=False, console=quiet)
        assert world.disturbed_photos == 0


def test_an_interrupt_during_the_fill_stops_the_pump_at_once(open_bench, config, scene, quiet, tmp_path) -> None:
    folder = tmp_path / "session"
    with open_bench(config, scene) as (devices, world):
        status = devices.pump.status

        def in_mid_fill() -> PumpStatus:
            if world.flow_direction() == "fill" and world.state().tank_ml > config.tank.fill_ml / 4:
                raise KeyboardInterrupt
            return status()

        interrupted = dataclasses.replace(devices, pump=Wrapped(devices.pump, status=in_mid_fill))
        with pytest.raises(CaptureStopped, match=r"stopped with 36 of 72 photos.*rig capture --resume"):
            capture(config, folder, devices=interrupted, scene=scene, resume=False, console=quiet)
        tank_ml = world.state().tank_ml
        assert 0 < tank_ml < config.tank.fill_ml
        world.clock.sleep_s(3600.0)
        assert world.state().tank_ml == tank_ml
    assert journal_of(folder)[-1]["tank_ml"] == pytest.approx(tank_ml)
    assert events_of(folder)[-4:] == ["fill_started", "fill_stopped", "came_to_rest", "capture_interrupted"]


def test_a_stage_that_was_pushed_stops_the_capture(open_bench, config, scene, quiet, tmp_path) -> None:
    with open_bench(config, scene) as (devices, world):
        expose = devices.camera.expose
        photos = iter(range(100))

        def pushed(*, timeout_s: float) -> None:
            if next(photos) == 5:
                world.start_motion(world.stage_mm() + 0.5, velocity_mm_per_s=1000.0)
            expose(timeout_s=timeout_s)

        with pytest.raises(CaptureError, match="moved it"):
            capture(
                config,
                tmp_path / "session",
                devices=dataclasses.replace(devices, camera=Wrapped(devices.camera, expose=pushed)),
                scene=scene,
                resume=False,
                console=quiet,
            )
    assert len(open_session(tmp_path / "session").photos) == 5


def test_a_pump_that_cannot_be_stopped_does_not_keep_the_stage_from_stopping(
    open_bench, config, scene, quiet, tmp_path
) -> None:
    stopped = []
    with open_bench(config, scene) as (devices, _):
        dead = DeviceTimeoutError("pump: silent")
        broken = dataclasses.replace(
            devices,
            pump=Wrapped(devices.pump, stop=fails_at(0, devices.pump.stop, dead)),
            stage=Wrapped(devices.stage, stop=lambda: stopped.append("stage")),
            camera=Wrapped(devices.camera, collect=fails_at(3, devices.camera.collect, dead)),
        )
        with pytest.raises(CaptureError, match="switch it off by hand: pump: silent"):
            capture(config, tmp_path / "session", devices=broken, scene=scene, resume=False, console=quiet)
    assert stopped == ["stage"]


def test_a_panel_of_another_size_is_refused_before_anything_moves(open_bench, config, scene, quiet, tmp_path) -> None:
    display = config.display.model_copy(update={"columns": 33})
    with open_bench(config, scene) as (devices, world):
        before_mm = world.stage_mm()
        with pytest.raises(CaptureError, match="33 × 32 device pixels configured, it has 32 × 32"):
            capture(
                config.model_copy(update={"display": display}),
                tmp_path / "session",
                devices=devices,
                scene=scene,
                resume=False,
                console=quiet,
            )
        assert world.stage_mm() == before_mm


def test_a_disk_without_room_is_noticed_before_the_first_photo(open_bench, config, scene, quiet, tmp_path) -> None:
    timing = config.timing.model_copy(update={"photo_mb": 1e9})
    with open_bench(config, scene) as (devices, _), pytest.raises(CaptureError, match="GB are free"):
        capture(
            config.model_copy(update={"timing": timing}),
            tmp_path / "session",
            devices=devices,
            scene=scene,
            resume=False,
            console=quiet,
        )


@pytest.mark.parametrize("call", ["expose", "collect"])
@pytest.mark.parametrize("error", [DeviceProtocolError("camera: half a file"), DeviceBusyError("camera: busy")])
def test_a_spoiled_photo_is_taken_again_with_its_frame_shown_anew(
    call: str, error: DeviceError, open_bench, thin_config, thin_scene, captured_thin, quiet, tmp_path, read_photo_bytes
) -> None:
    shown: list[int] = []
    with open_bench(thin_config, thin_scene) as (devices, _):
        show, collect, expose = devices.display.show, devices.camera.collect, devices.camera.expose
        calls = iter(range(10**6))

        def spoiled_collect(*, timeout_s: float) -> tuple[Photo, ...]:
            photos = collect(timeout_s=timeout_s)
            if call == "collect" and next(calls) == 4:
                raise error
            return photos

        def remembered(frame: Any, *, frame_id: int, timeout_s: float) -> None:
            shown.append(frame_id)
            show(frame, frame_id=frame_id, timeout_s=timeout_s)

        camera = Wrapped(devices.camera, collect=spoiled_collect)
        if call == "expose":
            camera = Wrapped(devices.camera, expose=fails_at(4, expose, error))
        spoilt = dataclasses.replace(devices, camera=camera, display=Wrapped(devices.display, show=remembered))
        capture(thin_config, tmp_path / "s", devices=spoilt, scene=thin_scene, resume=False, console=quiet)
    (entry,) = (entry for entry in journal_of(tmp_path / "s") if entry["event"] == "photo_spoiled")
    assert (entry["sweep"], entry["index"], entry["attempt"], entry["reason"]) == ("x", 2, 1, str(error))
    # The next frame is on the glass already when a download fails, but not when an exposure does.
    assert shown[:7] == ([0, 1, 2, 3, 4, 5, 4] if call == "collect" else [0, 1, 2, 3, 4, 4, 5])
    assert read_photo_bytes(tmp_path / "s") == captured_thin


def test_three_spoiled_photos_in_a_row_end_the_capture_with_what_the_camera_said(
    open_bench, config, scene, quiet, tmp_path
) -> None:
    tries: list[float] = []

    def never(*, timeout_s: float) -> None:
        tries.append(timeout_s)
        raise DeviceProtocolError("camera: half a file for ever")

    with open_bench(config, scene) as (devices, _):
        broken = dataclasses.replace(devices, camera=Wrapped(devices.camera, expose=never))
        with pytest.raises(DeviceProtocolError, match="half a file for ever"):
            capture(config, tmp_path / "s", devices=broken, scene=scene, resume=False, console=quiet)
    assert len(tries) == 3
    assert events_of(tmp_path / "s")[-5:] == [*["photo_spoiled"] * 3, "came_to_rest", "capture_failed"]


def test_a_display_that_refuses_a_frame_is_no_spoiled_photo(open_bench, config, scene, quiet, tmp_path) -> None:
    refused = DeviceProtocolError("display: does not fit")
    with open_bench(config, scene) as (devices, _):
        show = fails_at(4, devices.display.show, refused)
        broken = dataclasses.replace(devices, display=Wrapped(devices.display, show=show))
        with pytest.raises(DeviceProtocolError, match="does not fit"):
            capture(config, tmp_path / "s", devices=broken, scene=scene, resume=False, console=quiet)
    assert "photo_spoiled" not in events_of(tmp_path / "s")


@pytest.fixture(scope="module")
def captured_thin(thin_config, thin_scene, tmp_path_factory, read_photo_bytes) -> dict[str, bytes]:
    """The photos of a capture in which nothing goes wrong."""
    folder = tmp_path_factory.mktemp("thin") / "session"
    with open_devices(thin_config, simulation=Simulation(thin_scene)) as devices:
        capture(thin_config, folder, devices=devices, scene=thin_scene, resume=False, console=Console(quiet=True))
    return read_photo_bytes(folder)
