"""One capture from start to finish: a session opened or continued, a plan made from what is there, and run."""

import shutil
from contextlib import ExitStack
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from rich.console import Console

from recon.session import Session, SessionWriter, open_session
from rig.config import RigConfig
from rig.devices import Devices, TankDevices
from rig.errors import CaptureError, CaptureStopped
from rig.plan import all_photos, plan_capture, summarise
from rig.progress import CaptureProgress
from rig.sequencer import Sequencer
from rig.session_manifest import manifest_of
from rig.steps import PhotoKey
from rig.stop_request import StopRequest
from sim_backend.scene import Scene

# A disk that is filled to the last byte upsets more than this program.
DISK_RESERVE_BYTES = 200_000_000


@dataclass(frozen=True, slots=True)
class CaptureResult:
    """How a capture ended: photos of this run, and those that the session now holds of all that it needs."""

    photos_taken: int
    photos_done: int
    photos_needed: int


def whole_photos(session: Session) -> frozenset[PhotoKey]:
    """Return the photos that the journal names and the disk confirms: present, and of the recorded hash."""
    whole = set()
    for key, record in session.photos.items():
        path = session.folder / record.file
        if record.sha256 is not None and path.is_file() and sha256(path.read_bytes()).hexdigest() == record.sha256:
            whole.add(key)
    return frozenset(whole)


def capture(
    config: RigConfig,
    folder: Path,
    *,
    devices: Devices,
    scene: Scene | None,
    resume: bool,
    console: Console,
) -> CaptureResult:
    """Take every photo that the session still lacks.

    Raises
    ------
    CaptureError, DeviceError, SessionError
        The session keeps all photos so far and can be resumed.
    CaptureStopped
        The operator asked to stop; the message says how to go on.
    """
    with ExitStack() as stack:
        note = "[yellow]stopping after this photo; press Ctrl-C again to stop at once[/yellow]"
        stop = stack.enter_context(StopRequest(lambda: console.print(note)))
        done: frozenset[PhotoKey] = frozenset()
        if resume:
            writer = stack.enter_context(SessionWriter.reopen(folder))
            done = whole_photos(open_session(folder))
        else:
            manifest = manifest_of(config, devices=devices.records(), scene=scene)
            writer = stack.enter_context(SessionWriter.create(folder, manifest))
        with stop.at_once():
            tank_ml = tank_ml_now(config, devices)
        plan = plan_capture(config, done=done, tank_ml=tank_ml)
        summary = summarise(plan, config)
        _check_disk(folder, summary.gigabytes)
        writer.journal.append(
            "capture_resumed" if resume else "capture_started",
            photos=summary.photos,
            done=len(done),
            tank_ml=tank_ml,
            devices={name: record.model_dump() for name, record in devices.records().items()},
        )
        progress = stack.enter_context(CaptureProgress(console, total_s=summary.minutes * 60))
        sequencer = Sequencer(devices, writer, config, tank_ml=tank_ml, progress=progress, stop=stop)
        needed = len(all_photos(config))
        try:
            sequencer.run(plan)
        except (CaptureStopped, KeyboardInterrupt):
            have = needed - summary.photos + sequencer.photos.taken
            writer.journal.append("capture_interrupted", photos=have, tank_ml=sequencer.tank.tank_ml)
            raise CaptureStopped(
                f"stopped with {have} of {needed} photos; pump and stage stand still"
                + (f", the tank holds {sequencer.tank.tank_ml:.0f} ml" if config.tank else "")
                + f"; go on with `rig capture --resume --session {folder}{_rehearsal(devices, scene)}`"
            ) from None
        writer.journal.append("capture_finished", photos=needed)
        return CaptureResult(sequencer.photos.taken, needed, needed)


def _rehearsal(devices: Devices, scene: Scene | None) -> str:
    """Return the option of the command that opened ``devices``."""
    if scene is None:
        return ""
    return " --sim-wire" if devices.camera.info().kind == "emulated" else " --sim"


def tank_ml_now(config: RigConfig, devices: Devices | TankDevices) -> float:
    """Return what the tank holds, from its sensor or from a person; never from what a journal expects."""
    if config.tank is None:
        return 0.0
    if devices.level_sensor is not None:
        return devices.level_sensor.volume_ml()
    return devices.operator.tank_ml(fill_ml=config.tank.fill_ml)


def _check_disk(folder: Path, gigabytes: float) -> None:
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes < gigabytes * 1e9 + DISK_RESERVE_BYTES:
        raise CaptureError(
            f"{folder}: the photos will take about {gigabytes:.1f} GB, {free_bytes / 1e9:.1f} GB are free; "
            "make room or choose another disk"
        )
