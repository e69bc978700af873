"""Runs a plan on devices and writes the session: the side effects of a capture, one step at a time.

What must not be done is in :mod:`rig.tank.interlocks`, and each room asks before it acts. Every intent is in the journal before
its action begins.
"""

from collections.abc import Sequence
from itertools import zip_longest

from drivers.errors import DeviceError
from drivers.protocols import Photo
from recon.errors import SessionError
from recon.sessions.session import SessionWriter
from rig.capturing.causes import part_of_rig
from rig.capturing.exposure_keeper import ExposureKeeper
from rig.capturing.known import Known, SweepKey
from rig.capturing.photo_taker import PhotoTaker
from rig.capturing.progress import CaptureProgress
from rig.capturing.scene_watch import SceneWatch
from rig.capturing.stage_moves import StageMoves
from rig.capturing.stop_request import Boundary, StopRequest
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import CaptureError, NotStoppedError, SceneMovedError
from rig.live.live_capture import LiveCapture
from rig.planning.plan import reference_photo
from rig.planning.steps import (
    AskOperator,
    ChooseExposure,
    DrainTank,
    FillTank,
    FindSweptRange,
    HomeStage,
    JudgeSet,
    MoveStage,
    StartSweep,
    Step,
    TakePhoto,
    WaitUntilStill,
    step_duration_s,
    step_text,
)
from rig.planning.swept_range import find_swept_range
from rig.tank.guard import Guard
from rig.tank.tank_keeper import TankKeeper

POLL_S = 0.25


class PlanAgain(Exception):
    """What is done or known has changed, so that the rest of this plan is no longer the best one."""


class Sequencer:
    """Runs the steps of one capture; its rooms are the stage's, the tank's and the camera's part of it."""

    def __init__(
        self,
        devices: Devices,
        writer: SessionWriter,
        config: RigConfig,
        *,
        known: Known,
        live: LiveCapture | None,
        progress: CaptureProgress,
        stop: StopRequest,
    ) -> None:
        self._known = known
        self._live = live
        self._writer = writer
        self._devices = devices
        self._journal = writer.journal
        self._config = config
        self._progress = progress
        self._stop = stop
        self._guard = guard = Guard(pump=devices.pump, book=devices.book, tank=config.tank)
        self.stage = StageMoves(devices, writer.journal, config, guard=guard)
        self.tank = TankKeeper(devices, writer.journal, config, guard=guard)
        self.photos = PhotoTaker(devices, writer, config, stage=self.stage, guard=guard, wait=self._wait)
        watch = config.watch
        self._watch = SceneWatch(watch, config, writer, clock=devices.clock) if watch else None
        self._exposure = self._exposure_keeper()
        self.object_present: bool | None = None

    def _exposure_keeper(self) -> ExposureKeeper | None:
        wanted = self._config.capture.auto_exposure
        if wanted is None:
            return None
        keeper = ExposureKeeper(
            wanted, self._config, self._devices.camera, self._writer, self.photos, progress=self._progress
        )
        keeper.resume()
        return keeper

    def run(self, plan: Sequence[Step]) -> None:
        """Run every step; however it ends, pump and stage stand still afterwards and the journal says so."""
        try:
            self._prepare()
            for step, following in zip_longest(plan, plan[1:]):
                self._stop.check()
                self._progress.tell(step_text(step))
                self._do(step, following)
                self._progress.advance(step_duration_s(step, self._config))
                if isinstance(step, TakePhoto) and following is not None:
                    self._stop.passed(boundary_after(step, following))
        finally:
            with self._stop.resting():
                self.photos.keep_last()
                self.come_to_rest()

    def _prepare(self) -> None:
        """Refuse a panel of another size than configured, and freeze the camera's settings."""
        with part_of_rig("display"):
            screen = self._devices.display.screen()
        panel = self._config.display
        if (screen.columns, screen.rows) != (panel.columns, panel.rows):
            raise CaptureError(
                f"display: {panel.columns} × {panel.rows} device pixels configured, it has {screen.columns} × "
                f"{screen.rows}; correct section [display], or the display's zoom and rotation"
            )
        if self.photos.camera_settings:
            with part_of_rig("camera"):
                self._devices.camera.apply_settings(dict(self.photos.camera_settings))
        self.photos.forget_frame()

    def come_to_rest(self) -> None:
        """Stop pump and stage, each even if the other does not answer."""
        failed: list[str] = []
        for device in (self._devices.pump, self._devices.stage):
            if device is None:
                continue
            try:
                device.stop()
            except DeviceError as error:
                failed.append(str(error))
        try:
            self._journal.append("came_to_rest", tank_ml=self.tank.tank_ml, failed=failed)
        except SessionError:
            if not failed:  # a pump that runs on is worse news than a disk that is full
                raise
        if failed:
            raise NotStoppedError(f"could not be stopped, switch it off by hand: {'; '.join(failed)}")

    def _do(self, step: Step, following: Step | None) -> None:
        match step:
            case HomeStage():
                self.stage.home()
            case MoveStage():
                self.stage.move(step)
            case FillTank() | DrainTank():
                self._pump(step)
            case WaitUntilStill():
                self._wait(step.duration_s)
                self._await_stillness(step.reason)
            case AskOperator():
                self._ask(step)
            case StartSweep():
                self._start_sweep(step)
            case TakePhoto():
                self.photos.take(step, following if isinstance(following, TakePhoto) else None)
                if self._live is not None:
                    self._live.photo_saved(step, following)
                if self._exposure is not None and step.sweep == "white":
                    self._exposure.look_at(step)
                self._look_at_scene(step)
            case ChooseExposure():
                if self._exposure is not None:
                    self._exposure.choose(step.white)
            case FindSweptRange():
                find_swept_range(step.set_name, self._writer, self._config, self._known)
                raise PlanAgain
            case JudgeSet():
                self._judge(step)

    def _await_stillness(self, reason: str) -> None:
        """Wait on until the picture is still, where the scene is watched."""
        if self._watch is None:
            return

        def snap() -> tuple[Photo, ...]:
            self._stop.check()
            return self.photos.snap(reference_photo(self._config))

        self._watch.wait_until_still(reason, snap=snap, tell=self._progress.tell)

    def _look_at_scene(self, photo: TakePhoto) -> None:
        """Answer what a reference photo shows; a sweep that it makes void is planned again when the picture is still."""
        if self._watch is None:
            return
        outcome, void = self._watch.photo_saved(photo)
        if outcome.response == "stop":
            raise SceneMovedError(outcome.text)
        if outcome.text:
            self._progress.say(outcome.text)
        if outcome.response == "retake":
            if void is not None:
                self._void(void)
            self._await_stillness("the liquid was not still")
            raise PlanAgain

    def _void(self, sweep: SweepKey) -> None:
        """Forget the photos of a sweep that are to be taken again."""
        self._known.void(sweep)
        self.photos.taken -= {key for key in self.photos.taken if key[:2] == sweep}

    def _pump(self, step: FillTank | DrainTank) -> None:
        def on_poll(moved_ml: float) -> None:
            self._progress.tell(f"{step_text(step)}: {moved_ml:.0f} ml so far")
            self._stop.check()

        self.tank.flow(step, on_poll=on_poll)

    def _wait(self, duration_s: float) -> None:
        clock = self._devices.clock
        end_s = clock.now_s() + duration_s
        while (left_s := end_s - clock.now_s()) > 0:
            self._stop.check()
            clock.sleep_s(min(left_s, POLL_S))

    def _ask(self, step: AskOperator) -> None:
        self._guard.check("hands")
        self._journal.append("operator_asked", request=step.request, text=step.text)
        with self._stop.at_once():
            self._devices.operator.do(step.request, step.text)
        self._journal.append("operator_answered", request=step.request)
        if step.request in ("insert_object", "remove_object"):
            self.object_present = step.request == "insert_object"
        self.tank.moved_by_hand(step.request)

    def _judge(self, step: JudgeSet) -> None:
        if self._live is None:
            return
        verdicts = self._live.judge_set(step.set_name, on_poll=self._stop.check)
        self._known.judged |= {(step.set_name, axis) for axis in verdicts.good}
        for axis in verdicts.void:
            self._void((step.set_name, axis))
        if verdicts.fault:
            raise CaptureError(verdicts.fault)
        if verdicts.void:
            raise PlanAgain

    def _start_sweep(self, step: StartSweep) -> None:
        with part_of_rig("camera"):
            camera_settings = self._devices.camera.settings()
        self.tank.check_level()
        self._journal.append(
            "sweep_started",
            set=step.set_name,
            axis=step.axis,
            count=step.count,
            stage_mm=self.stage.check_position_mm(),
            tank_ml=self.tank.tank_ml,
            camera_settings=camera_settings,
        )


def boundary_after(photo: TakePhoto, following: Step) -> Boundary:
    """Return what ends with ``photo``: nothing but itself, its sweep, or the whole set."""
    same_set = isinstance(following, TakePhoto | StartSweep) and following.set_name == photo.set_name
    if not same_set:
        return "set"
    same_sweep = isinstance(following, TakePhoto) and following.sweep == photo.sweep
    return "photo" if same_sweep or photo.sweep not in ("x", "y") else "sweep"
