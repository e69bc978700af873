"""A capture that stands still: suspended until the cause is gone, or latched until a person says that they have looked.

Which cause leads to which is the table of :mod:`rig.capturing.causes`. Both are in the journal, so that a latch outlives the
process: a session that ended latched is not resumed before somebody says that they have looked.
"""

import logging
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from rich.console import Console

from drivers.errors import DeviceError
from drivers.protocols import Device, Frame
from recon.errors import SessionError
from recon.sessions.journal import JOURNAL_NAME, read_journal
from recon.sessions.session import SessionWriter
from rig.capturing.causes import Cause
from rig.capturing.disk_room import disk_fault
from rig.capturing.person import Person
from rig.capturing.stop_request import StopRequest
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import CaptureError
from rig.tank.flow import KEEP_AWAKE_EVERY_S

log = logging.getLogger(__name__)
# A cause that seems gone and comes back is asked less and less often.
PROBE_EVERY_S = 1.0
LONGEST_PROBE_S = 30.0
PROBE_TIMEOUT_S = 10.0
DARK_FRAME_ID = -1


class Standstill:
    """Waits, asks and remembers while nothing moves."""

    def __init__(
        self,
        devices: Devices,
        writer: SessionWriter,
        config: RigConfig,
        *,
        console: Console,
        person: Person | None,
        stop: StopRequest,
    ) -> None:
        self._devices = devices
        self._writer = writer
        self._config = config
        self._console = console
        self.person = person
        self._stop = stop
        self._awake_s = devices.clock.now_s()
        self._since: tuple[int, float] | None = None
        self._told = ""
        self._pause_s = PROBE_EVERY_S

    # Suspended

    def suspend(self, cause: Cause, error: Exception, *, photos: int) -> None:
        """Wait until the cause is gone; ``photos`` taken so far tell whether the last suspension brought the capture on.

        Raises
        ------
        Exception
            ``error`` itself, when the cause did not go away within the longest suspension.
        """
        clock = self._devices.clock
        if self._since is None or self._since[0] != photos:
            self._since = (photos, clock.now_s())
            self._told = ""
            self._pause_s = PROBE_EVERY_S
        self._tell(f"suspended: {error}; {cause.goes_on}")
        with suppress(SessionError):  # on a disk without room for a line, the wait itself is what counts
            self._writer_says("suspended", cause=cause.name, text=str(error))
        while True:
            if clock.now_s() - self._since[1] >= self._config.timing.longest_suspension_s:
                raise error
            self._stop.check()
            with self._stop.at_once():
                clock.sleep_s(self._pause_s)
            self.keep_awake()
            if self._is_gone(cause) and self._told_the_journal(cause, suspended_s=clock.now_s() - self._since[1]):
                break
        self._pause_s = min(2 * self._pause_s, LONGEST_PROBE_S)
        self._console.print("going on", markup=False)

    def _told_the_journal(self, cause: Cause, *, suspended_s: float) -> bool:
        """Write that the capture goes on; a disk that has no room for that line has none for a photo."""
        try:
            self._writer_says("went_on", cause=cause.name, suspended_s=round(suspended_s, 1))
        except SessionError:
            if cause.part != "disk":
                raise
            return False
        return True

    def _tell(self, text: str) -> None:
        """Say a thing once, not at every attempt."""
        if text != self._told:
            self._told = text
            self._console.print(text, markup=False)

    def _is_gone(self, cause: Cause) -> bool:
        """Ask the part itself: the display by showing darkness, the camera by its settings, the disk for its room."""
        try:
            match cause.part:
                case "display":
                    self._devices.display.screen()
                    dark = Frame(axis="x", levels=np.zeros(self._config.display.columns, dtype=np.uint8))
                    self._devices.display.show(dark, frame_id=DARK_FRAME_ID, timeout_s=PROBE_TIMEOUT_S)
                case "camera":
                    self._devices.camera.settings()
                case "disk":
                    return disk_fault(self._writer.folder, photo_mb=self._config.timing.photo_mb) is None
        except DeviceError as error:
            log.debug("still suspended: %s", error)
            return False
        return True

    def keep_awake(self) -> None:
        """Let the camera talk now and then, else it falls asleep while nothing is photographed."""
        now_s = self._devices.clock.now_s()
        if now_s - self._awake_s > KEEP_AWAKE_EVERY_S:
            self._awake_s = now_s
            with suppress(DeviceError):  # a camera that does not answer is told with the next photo
                self._devices.camera.keep_awake()

    # Latched

    def latch(self, cause: Cause, error: Exception, *, how_to_resume: str) -> None:
        """Stand still until a person has looked; raises ``CaptureError`` where nobody can be asked, or they decline."""
        with suppress(SessionError):  # on a full disk, what the person must do is still worth more than its line
            self._writer_says("latched", cause=cause.name, text=str(error))
        if self.person is None:
            raise CaptureError(f"{error}; when a person has looked and it is mended, {how_to_resume}") from error
        with self._stop.at_once():
            looked = self.person.has_looked(f"latched: {error}", idle=self.keep_awake)
        if not looked:
            raise CaptureError(f"{error}; when it is mended, {how_to_resume}") from error
        self._writer_says("unlatched", cause=cause.name, by="the operator")
        self._open_anew(cause)

    def _open_anew(self, cause: Cause) -> None:
        """Open a device that was lost once more: what is on its line since then belongs to nobody."""
        device: Device | None = self._devices.pump if cause.part == "pump" else self._devices.stage
        if device is not None:
            with suppress(DeviceError):  # what is lost cannot be closed properly
                device.__exit__(None, None, None)
            device.__enter__()

    def _writer_says(self, event: str, **fields: object) -> None:
        self._writer.journal.append(event, **fields)


def pending_latch(folder: Path) -> str | None:
    """Return what a session's last latch says, None where there is none or a person has looked since."""
    text = None
    for entry in read_journal(folder / JOURNAL_NAME):
        if entry["event"] == "latched":
            text = str(entry.get("text", ""))
        elif entry["event"] == "unlatched":
            text = None
    return text


def clear_latch(writer: SessionWriter, *, person: Person | None, checked: bool, idle: Callable[[], None]) -> None:
    """Let a session that ended latched go on, if somebody has looked; raises ``CaptureError`` otherwise."""
    text = pending_latch(writer.folder)
    if text is None:
        return
    if not checked:
        if person is None:
            raise CaptureError(
                f"this session ended because of what needs a person ({text}); look at tank, pump and stage, mend it, "
                "then resume with --checked"
            )
        if not person.has_looked(f"this session ended latched: {text}", idle=idle):
            raise CaptureError("not resumed; look at tank, pump and stage first")
    writer.journal.append("unlatched", by="--checked" if checked else "the operator")
