"""Runs a plan on devices and writes the session: the side effects of a capture, one step at a time.

Interlocks: nothing moves while the pump runs, no photo is taken while anything moves, no flow starts that would
take the tank past its free volume. Every intent is in the journal before its action begins.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest

from drivers.errors import DeviceBusyError, DeviceError, DeviceProtocolError
from drivers.protocols import FlowDirection, Photo
from recon.session import SessionWriter
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import CaptureError
from rig.flow import check_pump_stands, check_volume, run_flow
from rig.frames import frame_of
from rig.plan import (
    LEVEL_TOLERANCE,
    AskOperator,
    DrainTank,
    FillTank,
    HomeStage,
    MoveStage,
    StartSweep,
    Step,
    TakePhoto,
    WaitUntilStill,
    step_duration_s,
    step_text,
)
from rig.progress import CaptureProgress
from rig.stop_request import StopRequest
from rig.tag_check import TagCheck

SHOW_TIMEOUT_S = 10.0
# Libgphoto2 itself gives up on a photo after 90 s; ours is the shorter leash.
PHOTO_TIMEOUT_S = 60.0
# A camera that spoils three photos in a row needs a person. It gets a moment between them, for what it may still be doing.
PHOTO_ATTEMPTS = 3
RETRY_PAUSE_S = 1.0
# A stage may take twice its nominal time, plus what it takes to start.
STAGE_TIME_FACTOR = 2.0
STAGE_EXTRA_S = 10.0
POLL_S = 0.25
# The stage's position is compared with the plan before each sweep: a tenth of a millimetre is a lost step, not noise.
POSITION_TOLERANCE_MM = 0.1


class SpoiledPhotoError(Exception):
    """A photo was damaged, stale or somebody else's, or the camera was busy; ``fault`` is what it said."""

    def __init__(self, fault: DeviceError) -> None:
        super().__init__(str(fault))
        self.fault = fault


@contextmanager
def _spoils_the_photo() -> Iterator[None]:
    """Tell a camera's fault that a second photo can mend from one that it cannot, and from those of other devices."""
    try:
        yield
    except (DeviceBusyError, DeviceProtocolError) as fault:
        raise SpoiledPhotoError(fault) from fault


class Sequencer:
    """Runs the steps of one capture. ``tank_ml`` is the ledger: what the tank holds, as far as we know."""

    def __init__(
        self,
        devices: Devices,
        writer: SessionWriter,
        config: RigConfig,
        *,
        tank_ml: float,
        progress: CaptureProgress,
        stop: StopRequest,
    ) -> None:
        self._devices = devices
        self._writer = writer
        self._config = config
        self._progress = progress
        self._stop = stop
        self.tank_ml = tank_ml
        self.photos_taken = 0
        self._shown: int | None = None
        self._shown_at_s = -math.inf
        self._wanted_mm: float | None = None
        self._tag_check = TagCheck(config)

    def run(self, plan: Sequence[Step]) -> None:
        """Run every step; however it ends, pump and stage stand still afterwards and the journal says so."""
        try:
            self._prepare()
            for step, following in zip_longest(plan, plan[1:]):
                self._stop.check()
                if not isinstance(step, TakePhoto):
                    self._progress.tell(step_text(step))
                self._do(step, following)
                self._progress.advance(step_duration_s(step, self._config))
        finally:
            self.come_to_rest()

    def _prepare(self) -> None:
        """Refuse a panel of another size than configured, and freeze the camera's settings."""
        screen, panel = self._devices.display.screen(), self._config.display
        if (screen.columns, screen.rows) != (panel.columns, panel.rows):
            raise CaptureError(
                f"display: {panel.columns} × {panel.rows} device pixels configured, it has {screen.columns} × "
                f"{screen.rows}; correct section [display], or the display's zoom and rotation"
            )
        if self._config.camera.settings:
            self._devices.camera.apply_settings(self._config.camera.settings)

    def come_to_rest(self) -> None:
        """Stop pump and stage, each even if the other does not answer."""
        failed: list[str] = []
        for name, device in (("pump", self._devices.pump), ("stage", self._devices.stage)):
            if device is None:
                continue
            try:
                device.stop()
            except DeviceError as error:
                failed.append(f"{name}: {error}")
        self._writer.journal.append("came_to_rest", tank_ml=self.tank_ml, failed=failed)
        if failed:
            raise CaptureError(f"could not be stopped, switch it off by hand: {'; '.join(failed)}")

    def _do(self, step: Step, following: Step | None) -> None:
        match step:
            case HomeStage():
                self._home()
            case MoveStage():
                self._move(step)
            case FillTank():
                self._pump("fill", step)
            case DrainTank():
                self._pump("drain", step)
            case WaitUntilStill():
                self._wait(step.duration_s)
            case AskOperator():
                self._ask(step)
            case StartSweep():
                self._start_sweep(step)
            case TakePhoto():
                self._photograph(step, following if isinstance(following, TakePhoto) else None)

    # The stage

    def _home(self) -> None:
        check_pump_stands(self._devices, purpose="home the stage")
        self._writer.journal.append("homing_started")
        self._devices.stage.home(timeout_s=self._stage_timeout_s())
        self._writer.journal.append("homing_finished", stage_mm=self._devices.stage.position_mm())

    def _move(self, step: MoveStage) -> None:
        check_pump_stands(self._devices, purpose="move the stage")
        self._writer.journal.append("move_started", position=step.position, to_mm=step.position_mm)
        self._devices.stage.move_to_mm(step.position_mm, timeout_s=self._stage_timeout_s())
        self._wanted_mm = step.position_mm
        self._writer.journal.append("move_finished", position=step.position, stage_mm=self._check_position_mm())

    def _stage_timeout_s(self) -> float:
        stage = self._config.stage
        whole_travel_s = (stage.travel_mm[1] - stage.travel_mm[0]) / stage.velocity_mm_per_s
        return STAGE_TIME_FACTOR * whole_travel_s + STAGE_EXTRA_S

    def _check_position_mm(self) -> float:
        """Return where the stage says it is, or refuse to go on when that is not where it was sent."""
        found_mm = self._devices.stage.position_mm()
        if self._wanted_mm is not None and not abs(found_mm - self._wanted_mm) <= POSITION_TOLERANCE_MM:
            raise CaptureError(
                f"stage: {self._wanted_mm:.3f} mm asked, it stands at {found_mm:.3f} mm; "
                "somebody or something moved it; free it and resume the capture"
            )
        return found_mm

    # The liquid

    def _pump(self, direction: FlowDirection, step: FillTank | DrainTank) -> None:
        pump, tank = self._devices.pump, self._config.tank
        if pump is None or tank is None:
            raise CaptureError(f"the plan asks for a {direction}, but this rig has no pump; check section [tank]")
        check_pump_stands(self._devices, purpose=f"start a {direction}")
        check_volume(direction, volume_ml=step.volume_ml, tank_ml=self.tank_ml, tank=tank)
        before_ml = self.tank_ml
        self._writer.journal.append(
            f"{direction}_started", volume_ml=step.volume_ml, to_ml=step.to_ml, max_run_s=step.max_run_s
        )

        def on_poll(moved_ml: float) -> None:
            self._progress.tell(f"{step_text(step)}: {moved_ml:.0f} ml so far")
            self._stop.check()

        try:
            run_flow(self._devices, direction, volume_ml=step.volume_ml, max_run_s=step.max_run_s, on_poll=on_poll)
        finally:
            moved_ml = pump.status().moved_ml
            self.tank_ml = self._level_ml(before_ml + (moved_ml if direction == "fill" else -moved_ml))
            self._writer.journal.append(f"{direction}_stopped", moved_ml=moved_ml, tank_ml=self.tank_ml)
        if abs(self.tank_ml - step.to_ml) > LEVEL_TOLERANCE * tank.fill_ml:
            raise CaptureError(
                f"the {direction} ended with {self.tank_ml:.0f} ml in the tank instead of {step.to_ml:.0f} ml "
                f"(the pump counted {moved_ml:.0f} ml); look for a leak, an empty reservoir or a worn tube, then resume"
            )

    def _level_ml(self, ledger_ml: float) -> float:
        """Return what the tank holds: what the sensor says where there is one, else what the pump counted."""
        sensor = self._devices.level_sensor
        return ledger_ml if sensor is None else sensor.volume_ml()

    # Waiting and asking

    def _wait(self, duration_s: float) -> None:
        clock = self._devices.clock
        end_s = clock.now_s() + duration_s
        while (left_s := end_s - clock.now_s()) > 0:
            self._stop.check()
            clock.sleep_s(min(left_s, POLL_S))

    def _ask(self, step: AskOperator) -> None:
        check_pump_stands(self._devices, purpose="ask for hands in the tank")
        self._writer.journal.append("operator_asked", request=step.request, text=step.text)
        with self._stop.at_once():
            self._devices.operator.do(step.request, step.text)
        self._writer.journal.append("operator_answered", request=step.request)
        tank = self._config.tank
        if tank is not None and step.request in ("fill_tank", "drain_tank"):
            self.tank_ml = self._level_ml(tank.fill_ml if step.request == "fill_tank" else 0.0)

    # Photos

    def _start_sweep(self, step: StartSweep) -> None:
        self._writer.journal.append(
            "sweep_started",
            set=step.set_name,
            axis=step.axis,
            count=step.count,
            stage_mm=self._check_position_mm(),
            camera_settings=self._devices.camera.settings(),
        )

    def _photograph(self, photo: TakePhoto, following: TakePhoto | None) -> None:
        """Take and save one photo; a photo that is spoiled is taken again, with its frame shown anew."""
        self._progress.tell(f"{photo.set_name} {photo.sweep} {photo.index}")
        check_pump_stands(self._devices, purpose="take a photo")
        for attempt in range(1, PHOTO_ATTEMPTS + 1):
            try:
                files = self._taken(photo, following)
                break
            except SpoiledPhotoError as spoiled:
                self._shown = None
                self._writer.journal.append(
                    "photo_spoiled",
                    set=photo.set_name,
                    sweep=photo.sweep,
                    index=photo.index,
                    attempt=attempt,
                    reason=str(spoiled.fault),
                )
                if attempt == PHOTO_ATTEMPTS:
                    raise spoiled.fault from None
                self._wait(RETRY_PAUSE_S)
        self._save(photo, files)
        self.photos_taken += 1

    def _taken(self, photo: TakePhoto, following: TakePhoto | None) -> tuple[Photo, ...]:
        """Show, wait, expose; then show the next frame while this photo is downloaded."""
        if self._shown != photo.frame_id:
            self._show(photo)
        clock = self._devices.clock
        clock.sleep_s(self._shown_at_s + self._config.timing.settle_s - clock.now_s())
        with _spoils_the_photo():
            self._devices.camera.expose(timeout_s=PHOTO_TIMEOUT_S)
        if following is not None:
            self._show(following)
        with _spoils_the_photo():
            return self._devices.camera.collect(timeout_s=PHOTO_TIMEOUT_S)

    def _show(self, photo: TakePhoto) -> None:
        self._devices.display.show(frame_of(photo, self._config), frame_id=photo.frame_id, timeout_s=SHOW_TIMEOUT_S)
        self._shown = photo.frame_id
        self._shown_at_s = self._devices.clock.now_s()

    def _save(self, photo: TakePhoto, files: tuple[Photo, ...]) -> None:
        if not files:
            raise DeviceError(
                f"camera: no file for photo {photo.set_name} {photo.sweep} {photo.index}; resume to retry"
            )
        frame_tag = self._tag_check.check(photo, files)
        stage_mm = self._check_position_mm()
        device = {"frame_id": photo.frame_id, "stage_mm": stage_mm}
        if frame_tag is not None:
            device["frame_tag"] = frame_tag
        # Of a RAW and its JPEG, the JPEG comes last: the last line of the journal is the photo that is read.
        for file in sorted(files, key=lambda file: file.suffix.lower() in (".jpg", ".jpeg")):
            self._writer.save_photo(
                file.data,
                set_name=photo.set_name,
                sweep=photo.sweep,
                index=photo.index,
                suffix=file.suffix.lower(),
                place_px=photo.place_px,
                device={**device, "camera_file": file.name},
            )
