"""One photo of a capture: shown, settled, exposed, downloaded, checked and saved; a spoiled one is taken again."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from drivers.errors import DeviceBusyError, DeviceError, DeviceProtocolError
from drivers.protocols import Photo
from recon.errors import SessionError
from recon.sessions.session import SessionWriter
from rig.capturing.camera_freeze import CameraFreeze
from rig.capturing.causes import part_of_rig
from rig.capturing.disk_room import disk_fault
from rig.capturing.exposure_check import check_exposure
from rig.capturing.frames import frame_of
from rig.capturing.stage_moves import StageMoves
from rig.capturing.tag_check import TagCheck
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import CaptureError, DiskLowError, WrongFrameError
from rig.planning.steps import PhotoKey, TakePhoto
from rig.tank.guard import Guard

SWEEPS = ("x", "y")
SHOW_TIMEOUT_S = 10.0
# Libgphoto2 itself gives up on a photo after 90 s; ours is the shorter leash.
PHOTO_TIMEOUT_S = 60.0
# A camera that spoils three photos in a row needs a person. It gets a moment between them, for what it may still be doing.
PHOTO_ATTEMPTS = 3
RETRY_PAUSE_S = 1.0


class SpoiledPhotoError(Exception):
    """A photo was damaged, stale, of another frame, exposed otherwise or somebody else's, or the camera was busy.

    ``fault`` says which.
    """

    def __init__(self, fault: DeviceError | CaptureError) -> None:
        super().__init__(str(fault))
        self.fault = fault


@dataclass(slots=True, eq=False)
class Taken:
    """A photo as it came from the camera, not checked and not saved yet; ``device`` is its record."""

    photo: TakePhoto
    files: tuple[Photo, ...]
    device: dict[str, object]


@contextmanager
def _spoils_the_photo() -> Iterator[None]:
    """Tell a camera's fault that a second photo can mend from one that it cannot, and from those of other devices."""
    try:
        yield
    except (DeviceBusyError, DeviceProtocolError, WrongFrameError) as fault:
        raise SpoiledPhotoError(fault) from fault


class PhotoTaker:
    """Takes the photos of a capture. ``taken`` names those that it saved."""

    def __init__(
        self,
        devices: Devices,
        writer: SessionWriter,
        config: RigConfig,
        *,
        stage: StageMoves,
        guard: Guard,
        wait: Callable[[float], None],
    ) -> None:
        self._devices = devices
        self._writer = writer
        self._config = config
        self._stage = stage
        self._guard = guard
        self._wait = wait
        self._shown: int | None = None
        self._shown_at_s = -math.inf
        self._tag_check = TagCheck(config)
        self._freeze = CameraFreeze(devices.camera, writer, config.camera.settings)
        self._uncollected = False
        self._allowed: PhotoKey | None = None
        self._unchecked: Taken | None = None
        self._spoiled: tuple[TakePhoto, SpoiledPhotoError] | None = None
        self._fault_ahead: DeviceError | CaptureError | SessionError | None = None
        self.taken: set[PhotoKey] = set()

    def take(self, photo: TakePhoto, following: TakePhoto | None) -> None:
        """Take one photo and save it; a photo that is spoiled is taken again, with its frame shown anew.

        Within a sweep a photo is checked and saved while the next one is exposed and downloaded; when a sweep ends, all its
        photos are saved. What goes wrong with ``following``, which is prepared meanwhile, is raised when ``photo`` is safe.
        """
        if self._allowed != photo.key:
            self._allow(photo)
        self._allowed = None
        with part_of_rig("camera"):
            self._freeze.for_set(photo.set_name)
        for attempt in range(1, PHOTO_ATTEMPTS + 1):
            try:
                self._unchecked = self._taken(photo, following)
                break
            except SpoiledPhotoError as spoiled:
                self._note_spoiled(photo, spoiled, attempt)
        while self._spoiled is not None:
            (before, why), self._spoiled = self._spoiled, None
            self._take_again(before, why)
        # Every other photo is looked at as soon as it is taken.
        sweep_goes_on = photo.sweep in SWEEPS and following is not None and following.key[:2] == photo.key[:2]
        if self._fault_ahead is not None or not sweep_goes_on:
            self._finish()
        fault, self._fault_ahead = self._fault_ahead, None
        if fault is not None:
            raise fault

    def keep_last(self) -> None:
        """Save the last photo if it is sound, on the way out; one that is not is taken again another time."""
        taken, self._unchecked = self._unchecked, None
        if taken is None:
            return
        with suppress(SpoiledPhotoError, SessionError):
            self._check(taken)
            self._save(taken)

    def _finish(self) -> None:
        """Check and save the photo that was taken last, now; taken again if it is spoiled."""
        taken, self._unchecked = self._unchecked, None
        if taken is None:
            return
        try:
            self._check(taken)
        except SpoiledPhotoError as spoiled:
            self._take_again(taken.photo, spoiled)
        else:
            self._save(taken)

    def _take_again(self, photo: TakePhoto, spoiled: SpoiledPhotoError) -> None:
        """Take a spoiled photo anew, by itself."""
        self._note_spoiled(photo, spoiled, 1)
        for attempt in range(2, PHOTO_ATTEMPTS + 1):
            try:
                taken = self._taken(photo, None)
                self._check(taken)
                self._save(taken)
                return
            except SpoiledPhotoError as again:
                self._note_spoiled(photo, again, attempt)

    def _note_spoiled(self, photo: TakePhoto, spoiled: SpoiledPhotoError, attempt: int) -> None:
        """Write down a photo that was not kept; the last attempt ends with what was wrong with it."""
        self._shown = None
        self._writer.journal.append(
            "photo_spoiled",
            set=photo.set_name,
            sweep=photo.sweep,
            index=photo.index,
            attempt=attempt,
            reason=str(spoiled.fault),
        )
        if attempt == PHOTO_ATTEMPTS:
            raise spoiled.fault from None
        self._wait(RETRY_PAUSE_S)

    def _allow(self, photo: TakePhoto) -> None:
        """Ask the interlocks and the disk whether a photo may be taken; the answer holds for this photo alone."""
        self._guard.check("photo")
        no_room = disk_fault(self._writer.folder, photo_mb=self._config.timing.photo_mb)
        if no_room is not None:
            raise DiskLowError(no_room)
        self._allowed = photo.key

    def snap(self, photo: TakePhoto) -> tuple[Photo, ...]:
        """Take one photo and return its files; they do not become part of the session."""
        self._guard.check("photo")
        for attempt in range(1, PHOTO_ATTEMPTS + 1):
            try:
                taken = self._taken(photo, None)
                self._check(taken)
                return taken.files
            except SpoiledPhotoError as spoiled:
                self._note_spoiled(photo, spoiled, attempt)
        raise AssertionError("the last attempt returns or raises")

    def _taken(self, photo: TakePhoto, following: TakePhoto | None) -> Taken:
        """Show, wait, expose; then all that can be done while the photo is downloaded; return it as it came."""
        self._discard_uncollected()
        if self._shown != photo.frame_id:
            self._show(photo)
        clock = self._devices.clock
        clock.sleep_s(self._shown_at_s + self._config.timing.settle_s - clock.now_s())
        self._uncollected = True
        with _spoils_the_photo(), part_of_rig("camera"), self._guard.exposing():
            self._devices.camera.expose(timeout_s=PHOTO_TIMEOUT_S)
        self._while_it_comes(following)
        stage_mm = self._stage.check_position_mm()
        with _spoils_the_photo(), part_of_rig("camera"):
            files = self._devices.camera.collect(timeout_s=PHOTO_TIMEOUT_S)
            self._uncollected = False
            if not files:
                raise DeviceProtocolError(f"camera: no file for {_name(photo)}")
        return Taken(photo, files, {"frame_id": photo.frame_id, "stage_mm": stage_mm})

    def _while_it_comes(self, following: TakePhoto | None) -> None:
        """Show the next frame, save the photo before, and ask whether the next photo may be taken."""
        try:
            if following is not None:
                self._show(following)
            before, self._unchecked = self._unchecked, None
            if before is not None:
                try:
                    self._check(before)
                    self._save(before)
                except SpoiledPhotoError as spoiled:
                    self._spoiled = (before.photo, spoiled)
            if following is not None:
                self._allow(following)
        except (DeviceError, CaptureError, SessionError) as fault:
            self._fault_ahead = fault

    def _check(self, taken: Taken) -> None:
        """Let a photo prove its exposure and its frame; raises ``SpoiledPhotoError``."""
        with _spoils_the_photo(), part_of_rig("camera"):
            check_exposure(taken.files, self._freeze.settings, name=_name(taken.photo))
            frame_tag = self._tag_check.check(taken.photo, taken.files)
        if frame_tag is not None:
            taken.device["frame_tag"] = frame_tag

    @property
    def camera_settings(self) -> Mapping[str, str]:
        """What the camera is set to for every set."""
        return self._freeze.wanted

    def set_camera(self, settings: Mapping[str, str]) -> None:
        """Freeze the camera with these settings as well, beside those of the configuration."""
        self._freeze.want(settings)

    def _discard_uncollected(self) -> None:
        """Take from the camera what an earlier attempt left in it, so that it is not taken for the next photo."""
        if not self._uncollected:
            return
        with suppress(DeviceProtocolError), part_of_rig("camera"):  # there was none, or it is damaged: both are well
            self._devices.camera.collect(timeout_s=PHOTO_TIMEOUT_S)
        self._uncollected = False

    def forget_frame(self) -> None:
        """Show the next frame anew, and ask anew whether it may be: something else happened meanwhile."""
        self._shown = self._allowed = None

    def _show(self, photo: TakePhoto) -> None:
        self._shown = None
        with part_of_rig("display"):
            self._devices.display.show(frame_of(photo, self._config), frame_id=photo.frame_id, timeout_s=SHOW_TIMEOUT_S)
        self._shown = photo.frame_id
        self._shown_at_s = self._devices.clock.now_s()

    def _save(self, taken: Taken) -> None:
        photo = taken.photo
        # Of a RAW and its JPEG, the JPEG comes last: the last line of the journal is the photo that is read.
        for file in sorted(taken.files, key=lambda file: file.suffix.lower() in (".jpg", ".jpeg")):
            self._writer.save_photo(
                file.data,
                set_name=photo.set_name,
                sweep=photo.sweep,
                index=photo.index,
                suffix=file.suffix.lower(),
                place_px=photo.place_px,
                device={**taken.device, "camera_file": file.name},
            )
        self.taken.add(photo.key)


def _name(photo: TakePhoto) -> str:
    return f"photo {photo.set_name} {photo.sweep} {photo.index}"
