"""Paused, suspended, latched: what the operator reads, and what happens next."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceError,
    DeviceNotFoundError,
    DeviceTimeoutError,
    UnknownPositionError,
)
from drivers.protocols import Photo, PumpStatus
from rig.capturing.capture import capture
from rig.capturing.causes import CAUSES, cause_of, part_of_rig
from rig.capturing.person import Choice
from rig.capturing.standstill import pending_latch
from rig.config import RigConfig
from rig.errors import CaptureError, CaptureStopped


class Wrapped:
    """A device with some of its methods replaced."""

    def __init__(self, device: Any, **methods: Any) -> None:
        self._device = device
        self.__dict__.update(methods)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def __enter__(self) -> Any:
        return self._device.__enter__()

    def __exit__(self, *of_what: Any) -> Any:
        return self._device.__exit__(*of_what)


class Says:
    """A person with prepared answers, who remembers what they were told."""

    def __init__(self, *answers: Choice | bool) -> None:
        self._answers = iter(answers)
        self.told: list[str] = []

    def after_pause(self, text: str, *, idle: Callable[[], None]) -> Any:
        self.told.append(text)
        idle()
        return next(self._answers)

    def has_looked(self, text: str, *, idle: Callable[[], None]) -> Any:
        self.told.append(text)
        idle()
        return next(self._answers)


def failing(calls: range, method: Any, error: Exception) -> Any:
    """Let some calls of a method fail."""
    count = iter(range(10**9))

    def call(*args: Any, **kwargs: Any) -> Any:
        if next(count) in calls:
            raise error
        return method(*args, **kwargs)

    return call


def nothing_changed(devices: Any, world: Any) -> dict[str, Any]:  # noqa: ARG001  (as all changes of a rig)
    return {}


def away(part: str, method: str, calls: range, error: Exception) -> Callable[[Any, Any], dict[str, Any]]:
    """Change a rig so that some calls of one device's method fail."""

    def change(devices: Any, _: Any) -> dict[str, Any]:
        device = getattr(devices, part)
        return {part: Wrapped(device, **{method: failing(calls, getattr(device, method), error)})}

    return change


def journal_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


def only(folder: Path, event: str) -> dict[str, Any]:
    (entry,) = (entry for entry in journal_of(folder) if entry["event"] == event)
    return entry


@pytest.fixture
def paper() -> StringIO:
    return StringIO()


@pytest.fixture
def begin(open_bench, config, scene, paper, tmp_path, captured, read_photo_bytes) -> Any:
    """Return ``begin(change, ...)``: a capture with some devices changed; its photos must be those of a quiet day."""

    def begun(change: Callable[[Any, Any], dict[str, Any]], *, whole: bool = True, rig: RigConfig = config, **how: Any):
        with open_bench(rig, scene) as (devices, world):
            changed = dataclasses.replace(devices, **change(devices, world))
            console = Console(file=paper, width=1000)
            capture(rig, tmp_path / "s", devices=changed, scene=scene, resume=False, console=console, **how)
            assert world.disturbed_photos == 0
            assert world.state().overflow_ml == 0
        if whole:
            assert read_photo_bytes(tmp_path / "s") == read_photo_bytes(captured)
        return tmp_path / "s"

    return begun


# Suspended


def test_a_display_that_was_away_is_waited_for_and_no_photo_is_lost(begin, paper) -> None:
    asleep = DeviceError("display: the tablet sleeps; wake it")
    folder = begin(
        lambda devices, _: {
            "display": Wrapped(devices.display, show=failing(range(9, 30), devices.display.show, asleep))
        }
    )
    assert only(folder, "suspended")["cause"] == "display away"
    assert only(folder, "went_on")["suspended_s"] == pytest.approx(20, abs=1.5)
    said = paper.getvalue()
    assert said.count("suspended: display: the tablet sleeps; wake it; it goes on when the display shows") == 1
    assert "going on" in said
    photos = [entry for entry in journal_of(folder) if entry["event"] == "photo"]
    assert len(photos) == 72  # the photo whose successor could not be shown was kept


@pytest.mark.parametrize(
    "error",
    [
        DeviceBusyError("camera: busy"),
        DeviceTimeoutError("camera: silent"),
        DeviceNotFoundError("camera: unplugged"),
        DeviceAlarmError("camera: switch it off and on"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_a_camera_that_was_away_is_waited_for(begin, error: DeviceError) -> None:
    def change(devices: Any, _: Any) -> dict[str, Any]:
        away = failing(range(1, 8), devices.camera.settings, error)
        return {
            "camera": Wrapped(
                devices.camera, expose=failing(range(12, 15), devices.camera.expose, error), settings=away
            )
        }

    folder = begin(change)
    assert {entry["cause"] for entry in journal_of(folder) if entry["event"] == "suspended"} == {"camera away"}
    assert [entry["event"] for entry in journal_of(folder)].count("homing_started") == 1  # the stage is where it was


def test_a_photo_that_was_exposed_before_the_camera_went_away_is_not_taken_for_the_next(begin) -> None:
    lost = DeviceTimeoutError("camera: gone in the download")
    folder = begin(
        lambda devices, _: {
            "camera": Wrapped(devices.camera, collect=failing(range(5, 6), devices.camera.collect, lost))
        }
    )
    assert only(folder, "suspended")["text"] == "camera: gone in the download"


def test_a_disk_without_room_is_waited_for(begin, monkeypatch) -> None:
    real = shutil.disk_usage
    count = iter(range(10**9))

    def usage(path: Any) -> Any:
        found = real(path)
        return found._replace(free=1000) if next(count) in range(11, 20) else found

    monkeypatch.setattr(shutil, "disk_usage", usage)
    folder = begin(nothing_changed)
    assert only(folder, "suspended")["cause"] == "disk full"
    assert "make room or choose another disk" in only(folder, "suspended")["text"]


def test_what_stays_away_ends_the_capture_with_its_own_sentence(begin, config, tmp_path) -> None:
    soon = config.model_copy(update={"timing": config.timing.model_copy(update={"longest_suspension_s": 90.0})})
    gone = DeviceTimeoutError("display: nobody answers")
    with pytest.raises(DeviceTimeoutError, match="nobody answers"):
        begin(
            lambda devices, _: {
                "display": Wrapped(devices.display, show=failing(range(9, 10**9), devices.display.show, gone))
            },
            rig=soon,
        )
    assert journal_of(tmp_path / "s")[-1]["event"] == "capture_failed"
    assert pending_latch(tmp_path / "s") is None


# Latched


def alarm_at(number: int, world: Any, pump: Any) -> Any:
    """A leak that the pump's board reports from its ``number``-th question on, until somebody opens it anew."""
    count = iter(range(10**9))
    opened: list[bool] = []

    def status() -> PumpStatus:
        if next(count) >= number and not opened:
            world.stop_flow()
            return PumpStatus(False, None, 0.0, alarm="the leak sensor is wet")
        return pump.status()

    def enter(_: Any) -> Any:
        opened.append(True)
        return pump

    return type("Leaking", (Wrapped,), {"__enter__": enter})(pump, status=status)


def test_a_leak_latches_until_a_person_has_looked_and_then_nothing_is_believed(begin) -> None:
    person = Says(True)
    folder = begin(lambda devices, world: {"pump": alarm_at(30, world, devices.pump)}, person=person)
    assert only(folder, "latched")["cause"] == "alarm at the tank"
    (told,) = person.told
    assert told.startswith("latched: pump: the leak sensor is wet; it is not safe to take a photo")
    events = [entry["event"] for entry in journal_of(folder)]
    after = events[events.index("unlatched") :]
    assert after[1] == "homing_started"  # the position is unknown until the stage was homed


def test_nobody_at_the_terminal_means_that_the_latch_stays(open_bench, config, scene, begin, quiet, tmp_path) -> None:
    with pytest.raises(CaptureError, match=r"leak sensor is wet.*when a person has looked.*--resume.*--checked`"):
        begin(lambda devices, world: {"pump": alarm_at(30, world, devices.pump)}, whole=False)
    assert pending_latch(tmp_path / "s") is not None
    with open_bench(config, scene) as (devices, world):

        def resume(**how: Any) -> Any:
            return capture(config, tmp_path / "s", devices=devices, scene=scene, resume=True, console=quiet, **how)

        with pytest.raises(CaptureError, match=r"needs a person \(pump: the leak sensor is wet.*resume with --checked"):
            resume()
        with pytest.raises(CaptureError, match="not resumed; look at tank, pump and stage first"):
            resume(person=Says(False))
        assert world.state().tank_ml == 0
        assert resume(checked=True).photos_done == 72
    assert pending_latch(tmp_path / "s") is None


@pytest.mark.parametrize(
    "error", [DeviceTimeoutError("stage: silent"), UnknownPositionError("stage: lost its reference")]
)
def test_a_stage_that_is_lost_latches(begin, error: DeviceError) -> None:
    person = Says(True)
    folder = begin(
        lambda devices, _: {
            "stage": Wrapped(devices.stage, position_mm=failing(range(20, 21), devices.stage.position_mm, error))
        },
        person=person,
    )
    assert only(folder, "latched")["cause"] == "stage lost"
    assert person.told == [f"latched: {error}"]


def test_a_stage_that_was_pushed_latches(begin) -> None:
    def change(devices: Any, world: Any) -> dict[str, Any]:
        photos = iter(range(10**9))
        collect = devices.camera.collect

        def pushed(*, timeout_s: float) -> tuple[Photo, ...]:
            if next(photos) == 5:
                world.start_motion(world.stage_mm() + 0.5, velocity_mm_per_s=1000.0)
            return collect(timeout_s=timeout_s)

        return {"camera": Wrapped(devices.camera, collect=pushed)}

    person = Says(True)
    folder = begin(change, person=person)
    assert only(folder, "latched")["cause"] == "stage moved"
    assert "somebody or something moved it" in person.told[0]


def test_a_pump_that_is_silent_latches_and_the_level_is_asked_anew(begin, config) -> None:
    def change(devices: Any, world: Any) -> dict[str, Any]:
        # The board lost its power in the middle of the fill.
        silent = DeviceTimeoutError("pump: does not answer")
        status, count = devices.pump.status, iter(range(10**9))

        def asked() -> PumpStatus:
            if world.flow_direction() == "fill" and next(count) == 7:
                world.stop_flow()
                raise silent
            return status()

        return {"pump": Wrapped(devices.pump, status=asked)}

    folder = begin(change, person=Says(True))
    assert only(folder, "latched")["cause"] == "pump lost"
    first, second = (entry["volume_ml"] for entry in journal_of(folder) if entry["event"] == "fill_started")
    assert first == pytest.approx(config.tank.fill_ml)
    assert 0 < second < first  # only what is missing


def test_a_pump_that_does_not_obey_latches_and_says_to_switch_it_off(
    open_bench, config, scene, quiet, tmp_path
) -> None:
    with open_bench(config, scene) as (devices, _):
        deaf = failing(range(10**9), devices.pump.stop, DeviceTimeoutError("pump: silent"))
        rig = dataclasses.replace(devices, pump=Wrapped(devices.pump, stop=deaf))
        with pytest.raises(CaptureError, match=r"could not be stopped, switch it off by hand: pump: silent"):
            capture(config, tmp_path / "s", devices=rig, scene=scene, resume=False, console=quiet)
    assert only(tmp_path / "s", "latched")["cause"] == "not stopped"


def test_every_cause_of_the_table_can_be_reached() -> None:
    for cause in CAUSES:
        for kind in cause.errors:
            error: Exception = kind("x")
            if isinstance(error, DeviceError):
                with pytest.raises(DeviceError), part_of_rig(cause.part):
                    raise error
            assert cause_of(error) is cause


# Paused


def test_a_pause_after_each_set_is_answered_at_the_terminal(begin) -> None:
    person = Says("go_on", "go_on", "go_on", "go_on")
    folder = begin(nothing_changed, person=person, pause_after="set")
    assert [text.split(";")[0] for text in person.told] == [f"paused with {k} of 72 photos" for k in (18, 36, 54, 72)]
    events = [entry["event"] for entry in journal_of(folder)]
    assert events.count("homing_started") == 1
    assert events.count("paused") == events.count("went_on") == 4


def test_a_pause_can_be_moved_from_photo_to_sweep_to_set(begin) -> None:
    person = Says("sweep", "sweep", "set", "go_on", "go_on", "go_on")
    begin(nothing_changed, person=person, pause_after="photo")
    taken = [int(text.split()[2]) for text in person.told]
    assert taken == [1, 10, 18, 36, 54, 72]  # white; the end of x; the end of y is that of the set; then sets


def test_who_stops_at_a_pause_is_told_how_to_go_on(begin, tmp_path) -> None:
    with pytest.raises(CaptureStopped, match=r"stopped with 10 of 72 photos.*rig capture --resume --session .* --sim"):
        begin(nothing_changed, whole=False, person=Says("stop"), pause_after="sweep")
    assert journal_of(tmp_path / "s")[-1]["event"] == "capture_interrupted"


def test_a_pause_without_a_person_ends_the_command_and_says_so(begin) -> None:
    with pytest.raises(CaptureStopped, match="paused after this sweep with 10 of 72 photos"):
        begin(nothing_changed, whole=False, pause_after="sweep")
