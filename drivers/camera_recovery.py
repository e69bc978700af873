"""Brings back a camera that failed, by the next rung that works: see :data:`drivers.camera_link.RUNGS`."""

import logging
import time

from drivers.camera_link import CameraLink
from drivers.camera_process import CameraFault, CameraProcess
from drivers.errors import DeviceAlarmError, DeviceError, DeviceTimeoutError
from drivers.gphoto2_errors import BUSY

log = logging.getLogger(__name__)

# How long a busy camera is left alone before it is asked again.
BUSY_WAIT_S = 0.2


class CameraRecovery:
    """Remembers which rungs were tried since the last photo. ``count`` is how many were tried so far.

    ``suspect`` is set for a camera that is to be opened anew before it is used again.
    """

    def __init__(self, link: CameraLink) -> None:
        self.count = 0
        self.suspect = False
        self._link = link
        self._rung = 0

    def opened(self) -> CameraProcess:
        """Return the process of the open camera; one that is suspect is opened anew."""
        if self.suspect:
            self._link.close()
            self.suspect = False
        return self._link.opened()

    def photo_came(self) -> None:
        """Begin at the mildest rung when it fails again."""
        self._rung = 0

    def climb(self, fault: CameraFault, *, end_s: float) -> None:
        """Try rungs until one works; a busy camera that has passed all of them gets a moment.

        Raises
        ------
        DeviceAlarmError
            When none is left: above the last one there is only a person.
        DeviceTimeoutError
            When ``end_s``, a time of :func:`time.monotonic`, has passed.
        """
        rungs = self._link.rungs
        while self._rung < len(rungs):
            rung, self._rung = self._rung, self._rung + 1
            log.warning("camera: %s; %s", fault, rungs[rung])
            self.count += 1
            try:
                self._link.recover(rung)
                return
            except DeviceError as error:
                fault = CameraFault(str(error))
            if time.monotonic() >= end_s:
                self.suspect = True
                raise DeviceTimeoutError(f"camera {self._link.address}: a photo asked, {fault}")
        if fault.code == BUSY:
            # It answers, so it is not lost: what is left is to wait, as long as the caller allows.
            time.sleep(min(BUSY_WAIT_S, max(end_s - time.monotonic(), 0.0)))
            return
        self._rung = 0
        self._link.close()
        raise DeviceAlarmError(
            f"camera {self._link.address}: a photo asked, it does not work any more ({fault}); tried: "
            f"{', '.join(rungs)}. Switch it off and on, or take its battery out for a moment"
        )
