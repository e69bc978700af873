"""One photo of a capture: shown, settled, exposed, downloaded, checked and saved; a spoiled one is taken again."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.errors import DeviceBusyError, DeviceError, DeviceProtocolError
from drivers.protocols import Photo
from recon.session import SessionWriter
from rig.config import RigConfig
from rig.devices import Devices
from rig.flow import check_pump_stands
from rig.frames import frame_of
from rig.stage_moves import StageMoves
from rig.steps import TakePhoto
from rig.tag_check import TagCheck

SHOW_TIMEOUT_S = 10.0
# Libgphoto2 itself gives up on a photo after 90 s; ours is the shorter leash.
PHOTO_TIMEOUT_S = 60.0
# A camera that spoils three photos in a row needs a person. It gets a moment between them, for what it may still be doing.
PHOTO_ATTEMPTS = 3
RETRY_PAUSE_S = 1.0


class SpoiledPhotoError(Exception):
    """A photo was damaged, stale or somebody else's, or the camera was busy; ``fault`` is what it said."""

    def __init__(self, fault: DeviceError) -> None:
        super().__init__(str(fault))
        self.fault = fault


@contextmanager
def _spoils_the_photo() -> Iterator[None]:
    """Tell a camera's fault that a second photo can mend from one that it cannot, and from those of other devices."""
    try:
        yield
    except (DeviceBusyError, DeviceProtocolError) as fault:
        raise SpoiledPhotoError(fault) from fault


class PhotoTaker:
    """Takes the photos of a capture. ``taken`` counts those that are saved."""

    def __init__(
        self,
        devices: Devices,
        writer: SessionWriter,
        config: RigConfig,
        *,
        stage: StageMoves,
        wait: Callable[[float], None],
    ) -> None:
        self._devices = devices
        self._writer = writer
        self._config = config
        self._stage = stage
        self._wait = wait
        self._shown: int | None = None
        self._shown_at_s = -math.inf
        self._tag_check = TagCheck(config)
        self.taken = 0

    def take(self, photo: TakePhoto, following: TakePhoto | None) -> None:
        """Take and save one photo; a photo that is spoiled is taken again, with its frame shown anew."""
        check_pump_stands(self._devices, purpose="take a photo")
        for attempt in range(1, PHOTO_ATTEMPTS + 1):
            try:
                files = self._taken(photo, following)
                break
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
        self._save(photo, files)
        self.taken += 1

    def _taken(self, photo: TakePhoto, following: TakePhoto | None) -> tuple[Photo, ...]:
        """Show, wait, expose; then show the next frame while this photo is downloaded."""
        if self._shown != photo.frame_id:
            self._show(photo)
        clock = self._devices.clock
        clock.sleep_s(self._shown_at_s + self._config.timing.settle_s - clock.now_s())
        with _spoils_the_photo():
            self._devices.camera.expose(timeout_s=PHOTO_TIMEOUT_S)
        if following is not None:
            self._show(following)
        with _spoils_the_photo():
            return self._devices.camera.collect(timeout_s=PHOTO_TIMEOUT_S)

    def _show(self, photo: TakePhoto) -> None:
        self._devices.display.show(frame_of(photo, self._config), frame_id=photo.frame_id, timeout_s=SHOW_TIMEOUT_S)
        self._shown = photo.frame_id
        self._shown_at_s = self._devices.clock.now_s()

    def _save(self, photo: TakePhoto, files: tuple[Photo, ...]) -> None:
        if not files:
            raise DeviceError(
                f"camera: no file for photo {photo.set_name} {photo.sweep} {photo.index}; resume to retry"
            )
        frame_tag = self._tag_check.check(photo, files)
        stage_mm = self._stage.check_position_mm()
        device = {"frame_id": photo.frame_id, "stage_mm": stage_mm}
        if frame_tag is not None:
            device["frame_tag"] = frame_tag
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
