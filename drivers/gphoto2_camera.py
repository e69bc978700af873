"""Any camera that libgphoto2 can trigger, on USB or PTP/IP.

Written from libgphoto2's manual and header files (API of 2.5.34). Proven against the real library with emulated cameras;
has not met real hardware.

An exposure counts as over when the camera has announced the photo's files, because no PTP camera says when its shutter
closes. The library runs in a process of its own (:mod:`drivers.camera_process`). A camera that fails is brought back in rungs
(:mod:`drivers.camera_link`), and the photo is asked for again after each as long as the call's time lasts: the frame on
the display is still the same.
"""

import contextlib
import hashlib
import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from types import TracebackType
from typing import Any, Self

from drivers.camera_link import AWAKE_S, SETTINGS_S, CameraLink, of_the_link
from drivers.camera_process import CameraFault, LateFault, RefusedFault
from drivers.camera_profiles import wrong_setting
from drivers.errors import DeviceAlarmError, DeviceBusyError, DeviceError, DeviceProtocolError, DeviceTimeoutError
from drivers.gphoto2_errors import BUSY
from drivers.photo_check import fault_of_file
from drivers.protocols import DeviceInfo, DeviceKind, Photo

log = logging.getLogger(__name__)

PREVIEW_S = 10.0
# How long a busy camera is left alone before it is asked again.
BUSY_WAIT_S = 0.2
# One attempt at a photo: the longest exposure of most bodies is 30 s, but a sweep's are a second at most.
ATTEMPT_S = 20.0
# An emulated camera that somebody starts by hand says so here, and is never recorded as a real one.
EMULATED_SERIAL = "EMULATED"
CameraFile = tuple[str, bytes, int | None]


@dataclass(slots=True)
class CameraCounts:
    """What happened so far. ``strays`` are photos that somebody else took."""

    photos: int = 0
    strays: int = 0
    retaken: int = 0
    recoveries: int = 0


class Gphoto2Camera:
    """Implements :class:`drivers.protocols.Camera`. ``counts`` says what happened so far."""

    def __init__(
        self,
        address: str,
        *,
        profile: str = "",
        kind: DeviceKind = "real",
        attempt_s: float = ATTEMPT_S,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Take the camera at ``address``; it is opened on entering the context.

        Parameters
        ----------
        address
            ``usb:`` for the only camera on the USB, ``usb:BUS,DEVICE`` for one of several, or ``ptpip:HOST[:PORT[:PORT]]``.
        profile
            Name of a profile in :mod:`drivers.camera_profiles`; empty to choose by the model that the camera reports.
        kind
            What the session records: ``"emulated"`` when the address is that of an emulator.
        attempt_s
            How long one attempt at a photo may take before the camera counts as stuck.
        environment
            More environment variables for the process of the library.
        """
        self.counts = CameraCounts()
        self._link = CameraLink(address, profile=profile, environment=environment)
        self._kind: DeviceKind = kind
        self._attempt_s = attempt_s
        self._paths: list[tuple[str, str]] = []
        self._last_hashes: frozenset[str] = frozenset()
        self._rung = 0
        self._suspect = False  # open it anew before the next photo

    def __enter__(self) -> Self:
        self._link.opened()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._paths = []
        self._link.close()

    def info(self) -> DeviceInfo:
        """Say who answered when the camera was opened."""
        self._link.opened()
        who = self._link.identity
        version = f"{who.get('deviceversion', '')}, libgphoto2 {who['library']}".removeprefix(", ")
        pretends = who.get("serialnumber", "").startswith(EMULATED_SERIAL)
        kind = "emulated" if pretends and self._kind == "real" else self._kind
        return DeviceInfo(kind, who.get("cameramodel") or who["model"], self._link.address, version)

    # Settings

    def settings(self) -> dict[str, str]:
        """The exposure settings read back from the camera, under libgphoto2's names."""
        self._link.opened()
        names = tuple(dict.fromkeys([*self._link.profile.watched, *self._link.frozen]))
        settings: dict[str, str] = self._asked("settings", doing="its settings", limit_s=SETTINGS_S, names=names)
        return settings

    def battery(self) -> str:
        """The battery's charge in the camera's own words, such as ``75%``; empty where it does not tell."""
        found: dict[str, str] = self._asked(
            "settings", doing="its battery", limit_s=SETTINGS_S, names=("batterylevel",)
        )
        return found.get("batterylevel", "")

    def apply_settings(self, settings: dict[str, str]) -> None:
        """Freeze these settings and read them back; then check the ones that a sweep cannot do without.

        Raises
        ------
        DeviceProtocolError
            For a name or value that the camera does not have (nothing is set then), for one that did not take, and for
            autofocus, automatic exposure and the like.
        """
        self._asked("apply", doing="its settings", limit_s=SETTINGS_S, settings=settings)
        self._link.freeze(settings)
        found = self.settings()
        self._link.learn_format(found)
        wrong = wrong_setting(self._link.profile, found)
        if wrong is not None:
            raise DeviceProtocolError(f"camera {self._link.address}: {wrong}")

    def _asked(self, operation: str, *, doing: str, limit_s: float, **arguments: Any) -> Any:
        """Ask for something that is not a photo; a broken link is mended once."""
        try:
            return self._link.opened().call(operation, limit_s=limit_s, **arguments)
        except CameraFault as fault:
            if not of_the_link(fault):
                raise self._link.error(fault, doing=doing) from fault
        self._link.close()
        try:
            return self._link.opened().call(operation, limit_s=limit_s, **arguments)
        except CameraFault as fault:
            raise self._link.error(fault, doing=doing) from fault

    # Photos

    def expose(self, *, timeout_s: float) -> None:
        """Take one photo; returns when the camera has announced its file.

        Raises
        ------
        DeviceBusyError
            When the last photo was not collected, or the camera stays busy.
        DeviceTimeoutError
            When there was no photo in time.
        DeviceAlarmError
            When nothing that a program can do brings the camera back, or its card is full.
        """
        if self._paths:
            raise DeviceBusyError("camera: a second photo asked before the first was collected; collect it first")
        end_s = time.monotonic() + timeout_s
        while True:
            try:
                self._paths = self._exposed(min(self._attempt_s, end_s - time.monotonic()))
                self._rung = 0
                return
            except CameraFault as fault:
                if isinstance(fault, RefusedFault) or not (of_the_link(fault) or fault.code == BUSY):
                    raise self._link.error(fault, doing="a photo") from fault
                if time.monotonic() >= end_s:
                    raise self._out_of_time(fault, timeout_s=timeout_s) from fault
                self._climb(fault, end_s)

    def _out_of_time(self, fault: CameraFault, *, timeout_s: float) -> DeviceError:
        if fault.code == BUSY:
            return self._link.error(fault, doing="a photo")
        self._suspect = not isinstance(fault, LateFault)
        return DeviceTimeoutError(f"camera {self._link.address}: a photo within {timeout_s:g} s asked, {fault}")

    def _exposed(self, limit_s: float) -> list[tuple[str, str]]:
        """Take photos until there is one that came alone."""
        end_s = time.monotonic() + limit_s
        if self._suspect:
            self._link.close()
            self._suspect = False
        process = self._link.opened()
        while True:
            taken = process.call(
                "expose",
                limit_s=end_s - time.monotonic(),
                files=self._link.files_of_a_photo,
                deletes=self._link.profile.deletes,
            )
            self.counts.strays += taken["strays"]
            if not taken["mixed"]:
                paths: list[tuple[str, str]] = taken["paths"]
                return paths
            self.counts.retaken += 1
            log.warning("camera: somebody took a photo at the same moment; both are left out and one is taken anew")

    def _climb(self, fault: CameraFault, end_s: float) -> None:
        """Bring the camera back by the next rung that works; raises when there is none left, or no time."""
        rungs = self._link.rungs
        while self._rung < len(rungs):
            rung, self._rung = self._rung, self._rung + 1
            log.warning("camera: %s; %s", fault, rungs[rung])
            self.counts.recoveries += 1
            try:
                self._link.recover(rung)
                return
            except DeviceError as error:
                fault = CameraFault(str(error))
            if time.monotonic() >= end_s:
                self._suspect = True
                raise DeviceTimeoutError(f"camera {self._link.address}: a photo asked, {fault}")
        if fault.code == BUSY:
            # It answers, so it is not lost: what is left is to wait, as long as the caller allows.
            time.sleep(min(BUSY_WAIT_S, max(end_s - time.monotonic(), 0.0)))
            return
        self._rung = 0
        self._link.close()
        raise DeviceAlarmError(
            f"camera {self._link.address}: a photo asked, it does not work any more ({fault}); tried: "
            f"{', '.join(rungs)}. Switch it off and on, or take its battery out for a moment, then resume"
        )

    def collect(self, *, timeout_s: float) -> tuple[Photo, ...]:
        """Download the photo of the last ``expose``; two files for RAW and JPEG, each checked to be whole.

        Raises
        ------
        DeviceProtocolError
            When no photo was taken; when a file is damaged or repeats the photo before; when somebody else took a photo
            meanwhile, so that it is not certain which is ours. Expose again, with the frame shown anew.
        DeviceTimeoutError
            When the download took too long; it may be asked for again.
        """
        if not self._paths:
            raise DeviceProtocolError("camera: a photo was asked for, but none was taken; expose first")
        end_s = time.monotonic() + timeout_s
        files, strays = self._downloaded(end_s, timeout_s)
        fault = self._fault_of(files)
        if fault is not None:  # damaged on the way, perhaps: the camera still has it
            log.warning("camera: %s; it is downloaded again", fault)
            files, more_strays = self._downloaded(end_s, timeout_s)
            strays += more_strays
            fault = self._fault_of(files)
        paths, self._paths = self._paths, []
        self._release(paths)
        self.counts.strays += strays
        if strays:
            fault = f"somebody took {strays} more meanwhile, so it is not certain which is the right one"
        if fault is not None:
            raise DeviceProtocolError(
                f"camera {self._link.address}: a photo asked, {fault}; expose again, or resume the capture"
            )
        self._last_hashes = frozenset(hashlib.sha256(data).hexdigest() for _name, data, _size in files)
        self.counts.photos += 1
        return tuple(Photo(data, PurePosixPath(name).suffix.lower(), name) for name, data, _size in files)

    def _downloaded(self, end_s: float, timeout_s: float) -> tuple[list[CameraFile], int]:
        """Return the files of the last photo, through one re-opening of the camera where that is needed."""
        for mended in (False, True):
            try:
                answer = self._link.opened().call("collect", limit_s=end_s - time.monotonic(), paths=self._paths)
                return answer["files"], answer["strays"]
            except LateFault as fault:
                raise DeviceTimeoutError(
                    f"camera {self._link.address}: a download within {timeout_s:g} s asked, {fault}"
                ) from fault
            except CameraFault as fault:
                if mended or not of_the_link(fault) or time.monotonic() >= end_s:
                    self._paths = []
                    self._suspect = True
                    raise self._link.error(fault, doing="a download") from fault
                log.warning("camera: %s; opened again for its download", fault)
                self.counts.recoveries += 1
                self._link.close()
        raise AssertionError("both attempts end above")

    def _release(self, paths: list[tuple[str, str]]) -> None:
        if self._link.profile.deletes:
            with contextlib.suppress(CameraFault, DeviceError):  # it fails again, and is mended, with the next photo
                self._link.opened().call("spend", limit_s=AWAKE_S, paths=paths)

    def _fault_of(self, files: list[CameraFile]) -> str | None:
        for name, data, announced_bytes in files:
            fault = fault_of_file(data, suffix=PurePosixPath(name).suffix, announced_bytes=announced_bytes)
            if fault is not None:
                return f"its file {name} {fault}"
            if hashlib.sha256(data).hexdigest() in self._last_hashes:
                return f"its file {name} is byte for byte the photo before"
        return None

    # Between photos

    def keep_awake(self) -> None:
        """Let the camera talk, which keeps it from falling asleep. A failure is mended with the next photo."""
        try:
            self.counts.strays += self._link.opened().call("drain", limit_s=AWAKE_S)
        except (CameraFault, DeviceError) as fault:
            log.warning("camera: did not answer between two photos (%s); it is opened again for the next one", fault)
            self._suspect = True

    def live_view(self) -> bytes:
        """Return one frame of live view, a small JPEG; ``DeviceProtocolError`` where the camera has none."""
        frame: bytes = self._asked("preview", doing="a live view", limit_s=PREVIEW_S)
        return frame
