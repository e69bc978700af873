"""The photos of a camera that libgphoto2 has opened: exposed, downloaded, checked. Used by :mod:`drivers.gphoto2_camera`.

No PTP camera says when its shutter closes. An exposure counts as over

- strictly: when the camera has announced the photo's file, which an EOS does after the whole download;
- overlapping: when the shutter's time and the profile's margin have passed since the camera was told, or when the file is
  there. The download goes on while the next frame is shown. So the photo cannot be asked for again by the driver:
  whatever goes wrong from here on makes :meth:`CameraPhotos.collect` refuse it, and the caller shows its frame anew.
"""

import contextlib
import hashlib
import logging
import time
from pathlib import PurePosixPath

from drivers.camera_link import AWAKE_S, CameraLink, of_the_link
from drivers.camera_process import CameraFault, CameraProcess, LateFault, Question, RefusedFault
from drivers.camera_recovery import CameraRecovery
from drivers.errors import DeviceBusyError, DeviceError, DeviceProtocolError, DeviceTimeoutError
from drivers.gphoto2_errors import BUSY
from drivers.photo_check import fault_of_file
from drivers.protocols import Photo

log = logging.getLogger(__name__)

CameraFile = tuple[str, bytes, int | None]


class CameraPhotos:
    """One photo at a time: :meth:`expose`, then :meth:`collect`.

    Attributes
    ----------
    taken, strays, retaken
        Photos that were handed on; photos that somebody else took; photos left out because one of these came with them.
    """

    def __init__(self, link: CameraLink, recovery: CameraRecovery, *, attempt_s: float, overlap: bool) -> None:
        self.taken = 0
        self.strays = 0
        self.retaken = 0
        self._link = link
        self._recovery = recovery
        self._attempt_s = attempt_s
        self._overlap = overlap
        self._paths: list[tuple[str, str]] = []
        self._coming: tuple[CameraProcess, Question] | None = None
        self._last_hashes: frozenset[str] = frozenset()

    @property
    def is_coming(self) -> bool:
        """Whether the camera is busy with a download that was not collected yet."""
        return self._coming is not None

    def forget(self) -> None:
        """Let go of a photo that was not collected."""
        self._paths, self._coming = [], None

    def expose(self, *, timeout_s: float) -> None:
        """Take one photo; see :meth:`drivers.gphoto2_camera.Gphoto2Camera.expose`."""
        if self._paths or self._coming:
            raise DeviceBusyError("camera: a second photo asked before the first was collected; collect it first")
        end_s = time.monotonic() + timeout_s
        while True:
            try:
                self._expose_once(min(self._attempt_s, end_s - time.monotonic()), timeout_s=timeout_s)
                return
            except CameraFault as fault:
                if isinstance(fault, RefusedFault) or not (of_the_link(fault) or fault.code == BUSY):
                    raise self._link.error(fault, doing="a photo") from fault
                if time.monotonic() >= end_s:
                    raise self._out_of_time(fault, timeout_s=timeout_s) from fault
                self._recovery.climb(fault, end_s=end_s)

    def _out_of_time(self, fault: CameraFault, *, timeout_s: float) -> DeviceError:
        if fault.code == BUSY:
            return self._link.error(fault, doing="a photo")
        self._recovery.suspect = not isinstance(fault, LateFault)
        return DeviceTimeoutError(f"camera {self._link.address}: a photo within {timeout_s:g} s asked, {fault}")

    def _expose_once(self, limit_s: float, *, timeout_s: float) -> None:
        process = self._recovery.opened()
        over_s = self._link.exposure_over_s if self._overlap else None
        if over_s is None:
            self._paths = self._announced(process, limit_s)
            self._recovery.photo_came()
        elif over_s > limit_s:
            raise DeviceTimeoutError(
                f"camera {self._link.address}: a photo within {timeout_s:g} s asked, its exposure takes {over_s:g} s; "
                "allow more time"
            )
        else:
            self._release(process, limit_s, over_s=over_s)

    def _announced(self, process: CameraProcess, limit_s: float) -> list[tuple[str, str]]:
        """Take photos until there is one that came alone."""
        end_s = time.monotonic() + limit_s
        while True:
            answer = process.call("expose", limit_s=end_s - time.monotonic(), **self._expected())
            self.strays += answer["strays"]
            if not answer["mixed"]:
                paths: list[tuple[str, str]] = answer["paths"]
                return paths
            self.retaken += 1
            log.warning("camera: somebody took a photo at the same moment; both are left out and one is taken anew")

    def _release(self, process: CameraProcess, limit_s: float, *, over_s: float) -> None:
        """Take one photo, let its download begin, and wait until its exposure is over."""
        released = process.call("release", limit_s=limit_s, **self._expected())
        self.strays += released["strays"]
        question = process.ask("fetch", limit_s=self._attempt_s, **self._expected())
        self._coming = (process, question)
        process.wait(question, within_s=max(0.0, released["asked_s"] + over_s - time.monotonic()))

    def _expected(self) -> dict[str, int | bool]:
        return {"files": self._link.files_of_a_photo, "deletes": self._link.profile.deletes}

    def collect(self, *, timeout_s: float) -> tuple[Photo, ...]:
        """Return the last photo; see :meth:`drivers.gphoto2_camera.Gphoto2Camera.collect`."""
        end_s = time.monotonic() + timeout_s
        if self._coming is not None:
            files, strays = self._fetched(*self._coming, timeout_s=timeout_s)
        elif self._paths:
            files, strays = self._downloaded(end_s, timeout_s)
        else:
            raise DeviceProtocolError("camera: a photo was asked for, but none was taken; expose first")
        fault = self._fault_of(files)
        if fault is not None:  # damaged on the way, perhaps: the camera still has it
            log.warning("camera: %s; it is downloaded again", fault)
            files, more_strays = self._downloaded(end_s, timeout_s)
            strays += more_strays
            fault = self._fault_of(files)
        paths, self._paths = self._paths, []
        self._spend(paths)
        self.strays += strays
        if strays:
            fault = f"somebody took {strays} more meanwhile, so it is not certain which is the right one"
        if fault is not None:
            raise self._spoiled(fault)
        self._last_hashes = frozenset(hashlib.sha256(data).hexdigest() for _name, data, _size in files)
        self.taken += 1
        return tuple(Photo(data, PurePosixPath(name).suffix.lower(), name) for name, data, _size in files)

    def _spoiled(self, fault: str) -> DeviceProtocolError:
        return DeviceProtocolError(f"camera {self._link.address}: a photo asked, {fault}; expose again")

    def _fetched(self, process: CameraProcess, question: Question, *, timeout_s: float) -> tuple[list[CameraFile], int]:
        """Return the files of a photo whose download began with its exposure."""
        end_s = time.monotonic() + timeout_s
        if not process.wait(question, within_s=timeout_s):
            raise DeviceTimeoutError(
                f"camera {self._link.address}: a download within {timeout_s:g} s asked, it is not over; allow more time"
            )
        self._coming = None
        try:
            answer = process.answer(question)
        except CameraFault as fault:
            if isinstance(fault, RefusedFault) or not of_the_link(fault):
                raise self._link.error(fault, doing="a photo") from fault
            self._recovery.climb(fault, end_s=end_s)
            raise self._spoiled(str(fault)) from fault
        self.strays += answer["strays"]
        if answer["mixed"]:
            self.retaken += 1
            raise self._spoiled("somebody took one at the same moment, and both are left out")
        self._recovery.photo_came()
        self._paths = answer["paths"]
        return answer["files"], answer["late_strays"]

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
                    self._recovery.suspect = True
                    raise self._link.error(fault, doing="a download") from fault
                log.warning("camera: %s; opened again for its download", fault)
                self._recovery.count += 1
                self._link.close()
        raise AssertionError("both attempts end above")

    def _spend(self, paths: list[tuple[str, str]]) -> None:
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
