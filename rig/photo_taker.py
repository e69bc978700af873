"""One photo of a capture: shown, settled, exposed, downloaded, checked and saved; a spoiled one is taken again."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress

from drivers.errors import DeviceBusyError, DeviceError, DeviceProtocolError
from drivers.protocols import Photo
from recon.session import SessionWriter
from rig.camera_freeze import CameraFreeze
from rig.causes import part_of_rig
from rig.config import RigConfig
from rig.devices import Devices
from rig.disk_room import disk_fault
from rig.errors import CaptureError, DiskLowError, WrongFrameError
from rig.exposure_check import check_exposure
from rig.frames import frame_of
from rig.guard import Guard
from rig.stage_moves import StageMoves
from rig.steps import PhotoKey, TakePhoto
from rig.tag_check import TagCheck

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
        self._fault_ahead: DeviceError | CaptureError | None = None
        self.taken: set[PhotoKey] = set()

    def take(self, photo: TakePhoto, following: TakePhoto | None) -> None:
        """Take and save one photo; a photo that is spoiled is taken again, with its frame shown anew.

        What goes wrong with ``following``, which is prepared meanwhile, is raised when ``photo`` is safe.
        """
        if self._allowed != photo.key:
            self._allow(photo)
        self._allowed = None
        with part_of_rig("camera"):
            self._freeze.for_set(photo.set_name)
        files, device = self._sound(photo, following)
        self._save(photo, files, device)
        fault, self._fault_ahead = self._fault_ahead, None
        if fault is not None:
            raise fault

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
        return self._sound(photo, None)[0]

    def _sound(self, photo: TakePhoto, following: TakePhoto | None) -> tuple[tuple[Photo, ...], dict[str, object]]:
        """Return the files of a photo and their record, after as many attempts as it needs and may have."""
        for attempt in range(1, PHOTO_ATTEMPTS + 1):
            try:
                return self._taken(photo, following)
            except SpoiledPhotoError as spoiled:
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
        raise AssertionError("the last attempt returns or raises")

    def _taken(self, photo: TakePhoto, following: TakePhoto | None) -> tuple[tuple[Photo, ...], dict[str, object]]:
        """Show, wait, expose; then all that can be done while the photo is downloaded; return its files and their record."""
        self._discard_uncollected()
        if self._shown != photo.frame_id:
            self._show(photo)
        clock = self._devices.clock
        clock.sleep_s(self._shown_at_s + self._config.timing.settle_s - clock.now_s())
        self._uncollected = True
        with _spoils_the_photo(), part_of_rig("camera"), self._guard.exposing():
            self._devices.camera.expose(timeout_s=PHOTO_TIMEOUT_S)
        if following is not None:
            try:
                self._show(following)
                self._allow(following)
            except (DeviceError, CaptureError) as fault:
                self._fault_ahead = fault
        device: dict[str, object] = {"frame_id": photo.frame_id, "stage_mm": self._stage.check_position_mm()}
        with _spoils_the_photo(), part_of_rig("camera"):
            files = self._devices.camera.collect(timeout_s=PHOTO_TIMEOUT_S)
            self._uncollected = False
            name = f"photo {photo.set_name} {photo.sweep} {photo.index}"
            if not files:
                raise DeviceProtocolError(f"camera: no file for {name}")
            check_exposure(files, self._freeze.settings, name=name)
            frame_tag = self._tag_check.check(photo, files)
        return files, device if frame_tag is None else {**device, "frame_tag": frame_tag}

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

    def _save(self, photo: TakePhoto, files: tuple[Photo, ...], device: dict[str, object]) -> None:
        # Of a RAW and its JPEG, the JPEG comes last: the last line of the journal is the photo that is read.
        for file in sorted(files, key=lambda file: file.suffix.lower() in (".jpg", ".jpeg")):
            self._writer.save_photo(
                file.data,
                set_name=photo.set_name,
                sweep=photo.sweep,
                index=photo.index,
                suffix=file.suffix.lower(),
                place_px=photo.place_px,
                device={**device, "camera_file": file.name},
            )
        self.taken.add(photo.key)
