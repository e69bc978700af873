"""The line to one camera: opened, kept open, mended. Used by :class:`drivers.gphoto2_camera.Gphoto2Camera`.

A camera that fails is brought back in rungs, each harder than the one before; above the last one there is only a person.
"""

import contextlib
import logging
from collections.abc import Mapping

from drivers.camera_process import CameraFault, CameraProcess, LateFault, RefusedFault, WedgedFault
from drivers.camera_profiles import CameraProfile, profile_named, profile_of
from drivers.errors import DeviceError, DeviceNotFoundError, DeviceProtocolError, DeviceTimeoutError
from drivers.exposure_time import seconds_of
from drivers.gphoto2_errors import OF_THE_LINK, USB_CLAIM, device_error
from drivers.usb_cameras import find_usb_cameras, permission_fault, programs_holding, reset_usb_camera

log = logging.getLogger(__name__)

OPEN_S = 20.0
CLOSE_S = 5.0
SETTINGS_S = 20.0
AWAKE_S = 5.0
RESET_S = 15.0
# What is tried, in this order, when the camera fails. The last two exist on the USB alone.
RUNGS = ("let it come to itself", "opened it again", "reset its port", "reset its USB device")
RUNGS_ON_A_NETWORK = 2


def of_the_link(fault: CameraFault) -> bool:
    """Tell whether the fault may be gone once the camera is opened again."""
    return isinstance(fault, WedgedFault | LateFault) or fault.code in OF_THE_LINK


class CameraLink:
    """The camera at ``address``. What was frozen with :meth:`freeze` is set again whenever it is opened again.

    Attributes
    ----------
    identity
        What the camera said of itself when it was opened; empty before.
    files_of_a_photo
        Two where the camera writes RAW and JPEG side by side.
    exposure_s
        For how long its shutter opens; None where it does not tell.
    """

    def __init__(self, address: str, *, profile: str, environment: Mapping[str, str] | None) -> None:
        if not address.startswith(("usb:", "ptpip:")):
            raise DeviceNotFoundError(f"camera: address {address!r} asked; write usb:, usb:BUS,DEVICE or ptpip:HOST")
        self.address = address
        self.identity: dict[str, str] = {}
        self.frozen: dict[str, str] = {}
        self.files_of_a_photo = 1
        self.exposure_s: float | None = None
        self._chosen: CameraProfile | None = profile_named(profile) if profile else None
        self._environment = environment
        self._process: CameraProcess | None = None

    @property
    def rungs(self) -> tuple[str, ...]:
        """What can be tried to bring this camera back, the mildest first."""
        return RUNGS if self.address.startswith("usb:") else RUNGS[:RUNGS_ON_A_NETWORK]

    @property
    def profile(self) -> CameraProfile:
        """The profile that was chosen, or the one of the model that answered."""
        return self._chosen or profile_of(self.identity.get("cameramodel", "") or self.identity.get("model", ""))

    def opened(self) -> CameraProcess:
        """Return the process with the camera open in it, opening it where that is needed.

        Raises
        ------
        DeviceError
            When it cannot be opened, or does not take the settings that were frozen.
        """
        if self._process is not None and self._process.alive:
            return self._process
        process = self._process = CameraProcess(environment=self._environment)
        try:
            self.identity = process.call("open", limit_s=OPEN_S, address=self.address)
            if self.profile.capture_target is not None:
                process.call("apply", limit_s=SETTINGS_S, settings={"capturetarget": self.profile.capture_target})
            if self.frozen:
                process.call("apply", limit_s=SETTINGS_S, settings=self.frozen)
            names = ("imageformat", "imagequality", "shutterspeed")
            self.learn(process.call("settings", limit_s=SETTINGS_S, names=names))
        except CameraFault as fault:
            process.end()
            raise self.error(fault, doing="to open it", opening=True) from fault
        return process

    @property
    def exposure_over_s(self) -> float | None:
        """How long after the camera took the command its exposure is over for certain; None where that is not known."""
        margin_s = self.profile.exposure_margin_s
        return None if self.exposure_s is None or margin_s is None else self.exposure_s + margin_s

    def learn(self, settings: Mapping[str, str]) -> None:
        """Learn from settings that were read back how many files a photo has, and how long its exposure takes."""
        self.exposure_s = seconds_of(settings.get("shutterspeed", ""))
        both = any("+" in settings.get(name, "") for name in ("imageformat", "imagequality"))
        self.files_of_a_photo = 2 if both else 1

    def freeze(self, settings: Mapping[str, str]) -> None:
        """Remember settings that the camera took, for when it is opened again."""
        self.frozen |= settings

    def close(self) -> None:
        """Give the camera back; harmless when it is closed."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.alive:
            with contextlib.suppress(CameraFault):  # a camera that is gone needs no goodbye
                process.call("close", limit_s=CLOSE_S)
        process.end()

    def recover(self, rung: int) -> None:
        """Do what ``rungs[rung]`` says; raises ``DeviceError`` when that does not help."""
        if rung == 0:
            self._let_come_to_itself()
            return
        self.close()
        if rung == 2:
            self._reset_port()
        elif rung == 3:
            self._reset_usb()
        self.opened()

    def _let_come_to_itself(self) -> None:
        if self._process is None or not self._process.alive:
            raise DeviceTimeoutError("the process that speaks to it had to be ended")
        try:
            self._process.call("drain", limit_s=AWAKE_S)
        except CameraFault as fault:
            raise self.error(fault, doing="to come to itself") from fault

    def _reset_port(self) -> None:
        process = CameraProcess(environment=self._environment)
        try:
            process.call("reset_port", limit_s=RESET_S, address=self.address)
        except CameraFault as fault:
            raise self.error(fault, doing="a reset of its port") from fault
        finally:
            process.end()

    def _reset_usb(self) -> None:
        cameras = [camera for camera in find_usb_cameras() if self.address in ("usb:", camera.port)]
        if not cameras:
            raise DeviceNotFoundError(f"camera {self.address}: it is not on the USB any more; switch it on")
        back = reset_usb_camera(cameras[0], timeout_s=RESET_S)
        if self.address != "usb:":
            self.address = back.port

    def error(self, fault: CameraFault, *, doing: str, opening: bool = False) -> DeviceError:
        """Return what the operator reads."""
        if fault.code is not None:
            if opening and fault.code in (-7, -10):
                return DeviceNotFoundError(
                    f"camera {self.address}: {doing} asked, nothing answers there (libgphoto2 {fault.code}); "
                    "switch it on, and look at cable and address"
                )
            reason = self._reason_on_usb(fault.code) if self.address.startswith("usb:") else ""
            return device_error(fault.code, doing=doing, address=self.address, text=str(fault), reason=reason)
        sentence = f"camera {self.address}: {doing} asked, {fault}"
        if isinstance(fault, RefusedFault):
            return DeviceProtocolError(sentence)
        if isinstance(fault, WedgedFault) and opening:
            return DeviceNotFoundError(f"{sentence}; switch it off and on, and look at cable and address")
        return DeviceTimeoutError(sentence)

    def _reason_on_usb(self, code: int) -> str:
        """Say what the bus itself knows about a camera that could not be claimed or opened."""
        with contextlib.suppress(DeviceError):
            cameras = [camera for camera in find_usb_cameras() if self.address in ("usb:", camera.port)]
            if code == USB_CLAIM:
                programs = [program for camera in cameras for program in programs_holding(camera)]
                if programs:
                    return (
                        f"{', '.join(programs)} holds it; close it, or take the camera back with `gio mount -s gphoto2`"
                    )
            return next(filter(None, map(permission_fault, cameras)), "")
        return ""
