"""The loop of a capture: plan from what is done and known, run, answer what interrupts it, and plan again.

::

    plan ──► running ──► finished
     ▲          │
     │          ├── Ctrl-C, --pause-after ──► paused ──► go on, or stop
     │          ├── display, camera, disk away ──► suspended ──► back again
     │          └── water or stage in doubt ──► latched ──► a person has looked
     └──────────────────────────────┘

Pump and stage stand still in each of the three, and the journal says so.
"""

from contextlib import suppress

from drivers.errors import DeviceError
from recon.errors import SessionError
from recon.sessions.session import SessionWriter
from rig.capturing.causes import cause_of
from rig.capturing.known import Known
from rig.capturing.progress import CaptureProgress
from rig.capturing.sequencer import PlanAgain, Sequencer
from rig.capturing.standstill import Standstill
from rig.capturing.stop_request import StopRequest
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import CaptureError, CaptureStopped
from rig.live.live_capture import LiveCapture
from rig.planning.plan import all_photos, plan_capture
from rig.planning.steps import PhotoKey, Step, step_duration_s
from rig.tank.ledger import known_ml, level_text
from rig.tank.tank_keeper import learn_tank_ml


class CaptureRun:
    """Takes the photos that are missing; ``command`` is how the session is resumed."""

    def __init__(
        self,
        config: RigConfig,
        devices: Devices,
        writer: SessionWriter,
        *,
        known: Known,
        live: LiveCapture | None,
        progress: CaptureProgress,
        standstill: Standstill,
        stop: StopRequest,
        command: str,
    ) -> None:
        self._config = config
        self._devices = devices
        self._journal = writer.journal
        self._known = known
        self._progress = progress
        self._standstill = standstill
        self._stop = stop
        self._command = command
        self._sequencer = Sequencer(devices, writer, config, known=known, live=live, progress=progress, stop=stop)

    @property
    def taken(self) -> frozenset[PhotoKey]:
        """The photos that this run took."""
        return frozenset(self._sequencer.photos.taken)

    def until_done(self) -> None:
        """Run until every photo is taken.

        Raises
        ------
        CaptureStopped
            The operator asked to stop.
        CaptureError, DeviceError, SessionError
            Waiting does not mend it, or nobody is there to say that it is mended.
        """
        try:
            self._until_done()
        except (DeviceError, CaptureError, SessionError) as error:
            with suppress(SessionError):  # on a full disk the journal ends here, which is true as well
                self._journal.append("capture_failed", photos=self._have(), text=str(error))
            raise

    def _until_done(self) -> None:
        while plan := self._plan():
            try:
                self._sequencer.run(plan)
                return
            except PlanAgain:
                continue
            except CaptureStopped as stopped:
                self._pause(stopped)
            except KeyboardInterrupt:
                raise self._stopped("stopped") from None
            except (DeviceError, CaptureError, SessionError) as error:
                self._answer(error)

    def _plan(self) -> tuple[Step, ...]:
        sequencer, tank_ml = self._sequencer, known_ml(self._devices.book.ledger.tank)
        plan = plan_capture(
            self._config,
            done=self._known.done | self.taken,
            ranges=self._known.ranges,
            judged=self._known.judged,
            tank_ml=learn_tank_ml(self._devices, self._config) if tank_ml is None else tank_ml,
            position=sequencer.stage.position,
            object_present=sequencer.object_present,
        )
        self._progress.plan(sum(step_duration_s(step, self._config) for step in plan))
        return plan

    def _pause(self, stopped: CaptureStopped) -> None:
        """Ask the person how to go on; without one, or after a signal that is no Ctrl-C, stop."""
        person = self._standstill.person
        if person is None or not self._stop.may_go_on:
            raise self._stopped(str(stopped).removesuffix(" as asked")) from None
        self._journal.append("paused", photos=self._have(), tank_ml=self._sequencer.tank.tank_ml)
        try:
            with self._progress.hidden():
                self._stop.forget()
                with self._stop.at_once():
                    choice = person.after_pause(self._where("paused"), idle=self._standstill.keep_awake)
        except KeyboardInterrupt:
            choice = "stop"
        if choice == "stop":
            raise self._stopped("stopped") from None
        if choice != "go_on":
            self._stop.pause_after = choice
        self._journal.append("went_on", cause="pause")

    def _answer(self, error: DeviceError | CaptureError | SessionError) -> None:
        """Suspend or latch, whichever the cause asks for; raises what neither can mend."""
        cause = cause_of(error)
        if cause is None or cause.response == "stop":
            raise error
        try:
            with self._progress.hidden():
                if cause.response == "suspend":
                    self._standstill.suspend(cause, error, photos=len(self.taken))
                    return
                self._standstill.latch(cause, error, how_to_resume=f"go on with `{self._command} --checked`")
                self._sequencer.stage.forget()
                with self._stop.at_once():
                    learn_tank_ml(self._devices, self._config, looked=True)
        except (CaptureStopped, KeyboardInterrupt):
            raise self._stopped("stopped") from None

    def _have(self) -> int:
        return len(self._needed() & (self._known.done | self.taken))

    def _needed(self) -> frozenset[PhotoKey]:
        """The photos of a whole session, as far as is known by now."""
        return frozenset(photo.key for photo in all_photos(self._config, self._known.ranges))

    def _where(self, how: str) -> str:
        tank = f", the tank holds {level_text(self._devices.book.ledger.tank)}" if self._config.tank else ""
        needed = len(self._needed())
        return f"{how} with {self._have()} of {needed} photos; pump and stage stand still{tank}"

    def _stopped(self, how: str) -> CaptureStopped:
        self._journal.append("capture_interrupted", photos=self._have(), tank_ml=self._sequencer.tank.tank_ml)
        return CaptureStopped(f"{self._where(how)}; go on with `{self._command}`")
