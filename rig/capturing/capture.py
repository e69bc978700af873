"""One capture from start to finish: a session opened or continued, a plan made from what is there, and run.

What interrupts it leads back here: everything stands still, and when the cause is gone the plan is made again from what
is done and known by then.
"""

from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress

from recon.scene.scene_check import REFERENCE
from recon.sessions.journal import JOURNAL_NAME, read_journal
from recon.sessions.session import Session, SessionWriter, open_session
from rig.calibrating.session_calibration import keep_response, with_calibration_of
from rig.capture_sections import PhaseShiftCode
from rig.capturing.aftermath import aftermath, aftermath_text
from rig.capturing.capture_run import CaptureRun
from rig.capturing.disk_room import disk_fault
from rig.capturing.known import Known, known_of
from rig.capturing.person import Person
from rig.capturing.progress import CaptureProgress
from rig.capturing.session_check import check_session, check_text
from rig.capturing.session_manifest import manifest_of
from rig.capturing.standstill import Standstill, clear_latch
from rig.capturing.stop_request import Boundary, StopRequest
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import CaptureError, CaptureStopped
from rig.live.live_capture import LiveCapture
from rig.planning.plan import all_photos, plan_capture, summarise
from rig.tank.tank_keeper import learn_tank_ml
from sim_backend.scene import Scene


@dataclass(frozen=True, slots=True)
class CaptureResult:
    """How a capture ended: photos of this run, and those that the session now holds of all that it needs."""

    photos_taken: int
    photos_done: int
    photos_needed: int


def capture(
    config: RigConfig,
    folder: Path,
    *,
    devices: Devices,
    scene: Scene | None,
    resume: bool,
    console: Console,
    person: Person | None = None,
    pause_after: Boundary | None = None,
    checked: bool = False,
) -> CaptureResult:
    """Take every photo that the session still lacks.

    Parameters
    ----------
    person
        Who is asked at a pause and at a latch; None where nobody is at the terminal, and both end the command.
    pause_after
        Where to pause each time: after a photo, a sweep or a set.
    checked
        Somebody has looked after what latched the session.

    Raises
    ------
    CaptureError, DeviceError, SessionError
        The session keeps all photos so far and can be resumed.
    CaptureStopped
        The operator asked to stop; the message says how to go on.
    """
    with ExitStack() as stack:
        what = "pausing" if person is not None else "stopping"
        note = f"[yellow]{what} after this photo; press Ctrl-C again to stop at once[/yellow]"
        stop = stack.enter_context(StopRequest(lambda: console.print(note), pause_after=pause_after))
        known = Known()
        if resume:
            session = open_session(folder)
            with stop.at_once():
                known = look_at_session(session, config, console=console)
            writer = stack.enter_context(SessionWriter.reopen(folder))
            clear_latch(writer, person=person, checked=checked, idle=devices.camera.keep_awake)
        else:
            manifest, doubts = with_calibration_of(
                manifest_of(config, devices=devices.records(), scene=scene), config.calibration
            )
            for doubt in doubts:
                console.print(f"[yellow]warning:[/yellow] {escape(doubt)}")
            writer = stack.enter_context(SessionWriter.create(folder, manifest))
        if isinstance(config.capture.code, PhaseShiftCode):
            keep_response(folder, config.calibration)
        with stop.at_once():
            tank_ml = learn_tank_ml(devices, config, looked=checked)
        photos = summarise(plan_capture(config, done=known.done, ranges=known.ranges, tank_ml=tank_ml), config).photos
        no_room = disk_fault(folder, photo_mb=config.timing.photo_mb, photos=photos)
        if no_room is not None:
            raise CaptureError(no_room)
        writer.journal.append(
            "capture_resumed" if resume else "capture_started",
            photos=photos,
            done=len(known.done),
            tank_ml=tank_ml,
            devices={name: record.model_dump() for name, record in devices.records().items()},
        )
        progress = stack.enter_context(CaptureProgress(console))
        live = None
        if config.live is not None:
            live = stack.enter_context(LiveCapture(config.live, config, writer, progress=progress, console=console))
        run = CaptureRun(
            config,
            devices,
            writer,
            known=known,
            live=live,
            progress=progress,
            standstill=Standstill(devices, writer, config, console=console, person=person, stop=stop),
            stop=stop,
            command=f"rig capture --resume --session {folder}{_rehearsal(devices, scene)}",
        )
        run.until_done()
        needed = len(all_photos(config, known.ranges))
        writer.journal.append("capture_finished", photos=needed)
        if live is not None:
            with suppress(CaptureStopped, KeyboardInterrupt):  # every photo is saved: there is nothing left to stop
                live.finish(on_poll=stop.check)
        return CaptureResult(len([key for key in run.taken if key[1] != REFERENCE]), needed, needed)


def look_at_session(session: Session, config: RigConfig, *, console: Console) -> Known:
    """Read every photo of a session that is to be resumed, and say what is there and how the last program ended."""
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading the photos so far", total=len(session.photos))
        found = check_session(session, on_photo=lambda done, _: bar.update(task, completed=done))
    planned = [photo.key for photo in all_photos(config, session.ranges)]
    after = aftermath(read_journal(session.folder / JOURNAL_NAME))
    for line in (*check_text(found, planned=planned), *aftermath_text(after)):
        console.print(f"{session.folder}: {line}", markup=False)
    return known_of(session, found)


def _rehearsal(devices: Devices, scene: Scene | None) -> str:
    """Return the option of the command that opened ``devices``."""
    if scene is None:
        return ""
    return " --sim-wire" if devices.camera.info().kind == "emulated" else " --sim"
