"""Any camera that libgphoto2 can trigger, on USB or PTP/IP.

Written from libgphoto2's manual and header files (API of 2.5.34). Proven against the real library with emulated cameras;
has not met real hardware.

The library runs in a process of its own (:mod:`drivers.camera_process`). A camera that fails is brought back in rungs
(:mod:`drivers.camera_recovery`), and the photo is asked for again after each as long as the call's time lasts and the frame
on the display is still the same. When an exposure counts as over is told in :mod:`drivers.camera_photos`.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from drivers.camera_link import AWAKE_S, SETTINGS_S, CameraLink, of_the_link
from drivers.camera_photos import CameraPhotos
from drivers.camera_process import CameraFault
from drivers.camera_profiles import wrong_setting
from drivers.camera_recovery import CameraRecovery
from drivers.errors import DeviceBusyError, DeviceError, DeviceProtocolError
from drivers.protocols import DeviceInfo, DeviceKind, Photo

log = logging.getLogger(__name__)

PREVIEW_S = 10.0
# One attempt at a photo: the longest exposure of most bodies is 30 s, but a sweep's are a second at most.
ATTEMPT_S = 20.0
# An emulated camera that somebody starts by hand says so here, and is never recorded as a real one.
EMULATED_SERIAL = "EMULATED"


@dataclass(frozen=True, slots=True)
class CameraCounts:
    """What happened so far. ``strays`` are photos that somebody else took."""

    photos: int
    strays: int
    retaken: int
    recoveries: int


class Gphoto2Camera:
    """Implements :class:`drivers.protocols.Camera`. ``counts`` says what happened so far."""

    def __init__(
        self,
        address: str,
        *,
        profile: str = "",
        kind: DeviceKind = "real",
        attempt_s: float = ATTEMPT_S,
        overlap: bool = False,
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
        overlap
            Let ``expose`` return when the shutter has closed, while the photo is still on its way. Only for a caller who
            proves from each photo which frame it shows. Without effect on a camera whose profile has no
            ``exposure_margin_s``, or whose exposure time cannot be read.
        environment
            More environment variables for the process of the library.
        """
        self._link = CameraLink(address, profile=profile, environment=environment)
        self._kind: DeviceKind = kind
        self._recovery = CameraRecovery(self._link)
        self._photos = CameraPhotos(self._link, self._recovery, attempt_s=attempt_s, overlap=overlap)

    @property
    def counts(self) -> CameraCounts:
        """What happened so far."""
        photos = self._photos
        return CameraCounts(photos.taken, photos.strays, photos.retaken, self._recovery.count)

    def __enter__(self) -> Self:
        self._link.opened()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._photos.forget()
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

    def setting_choices(self, name: str) -> tuple[str, ...]:
        """The values that the body offers for a setting, in libgphoto2's words; empty where only the body can change it."""
        self._link.opened()
        choices: tuple[str, ...] = self._asked("choices", doing=f"the choices of {name}", limit_s=SETTINGS_S, name=name)
        return choices

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
        self._link.learn(found)
        wrong = wrong_setting(self._link.profile, found)
        if wrong is not None:
            raise DeviceProtocolError(f"camera {self._link.address}: {wrong}")

    def _asked(self, operation: str, *, doing: str, limit_s: float, **arguments: Any) -> Any:
        """Ask for something that is not a photo; a broken link is mended once."""
        if self._photos.is_coming:
            raise DeviceBusyError(f"camera: {doing} asked while a photo is on its way; collect it first")
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
        """Take one photo; returns when its exposure is over and the display may change.

        Raises
        ------
        DeviceBusyError
            When the last photo was not collected, or the camera stays busy.
        DeviceTimeoutError
            When there was no photo in time.
        DeviceAlarmError
            When nothing that a program can do brings the camera back, or its card is full.
        """
        self._photos.expose(timeout_s=timeout_s)

    def collect(self, *, timeout_s: float) -> tuple[Photo, ...]:
        """Hand over the photo of the last ``expose``; two files for RAW and JPEG, each checked to be whole.

        Raises
        ------
        DeviceProtocolError
            When no photo was taken; when a file is damaged or repeats the photo before; when somebody else took a photo
            meanwhile, so that it is not certain which is ours; with ``overlap``, when no photo came. Expose again, with
            the frame shown anew.
        DeviceTimeoutError
            When the download took too long; it may be asked for again.
        DeviceAlarmError
            When nothing that a program can do brings the camera back.
        """
        return self._photos.collect(timeout_s=timeout_s)

    # Between photos

    def keep_awake(self) -> None:
        """Let the camera talk, which keeps it from falling asleep. A failure is mended with the next photo."""
        if self._photos.is_coming:
            return  # it talks already
        try:
            self._photos.strays += self._link.opened().call("drain", limit_s=AWAKE_S)
        except (CameraFault, DeviceError) as fault:
            log.warning("camera: did not answer between two photos (%s); it is opened again for the next one", fault)
            self._recovery.suspect = True

    def live_view(self) -> bytes:
        """Return one frame of live view, a small JPEG; ``DeviceProtocolError`` where the camera has none."""
        frame: bytes = self._asked("preview", doing="a live view", limit_s=PREVIEW_S)
        return frame
