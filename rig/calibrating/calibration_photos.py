"""Photos of a calibration: a frame shown, a photo taken at a known time after the command, kept, and decoded."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from drivers.errors import DeviceProtocolError
from drivers.protocols import Frame, Photo
from recon.sessions.photos import decode_grey
from rig.calibrating.calibration_devices import CameraAndDisplay
from rig.calibrating.calibration_folder import CalibrationFolder
from rig.capturing.exposure_check import exposure_of_jpeg, exposure_of_settings
from rig.capturing.photo_taker import PHOTO_TIMEOUT_S, SHOW_TIMEOUT_S
from rig.capturing.tag_check import DECODABLE
from rig.config import RigConfig
from rig.errors import ConfigError

LARGEST_FRAME_ID = 65535


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """One photo: its counts, when its shutter was told to open, and how long after the command to show its frame.

    ``name`` is that of its file (0003).
    """

    grey: np.ndarray
    opened_s: float
    after_s: float
    exposure_s: float | None
    file: Photo
    name: str

    def colours(self) -> np.ndarray | None:
        """Return the planes blue, green and red [rows, cols, 3]; None where the file cannot be decoded so."""
        decoded = cv2.imdecode(np.frombuffer(self.file.data, np.uint8), cv2.IMREAD_COLOR)
        return None if decoded is None else np.asarray(decoded)


class CalibrationCamera:
    """Shows frames and photographs them with the configured devices; every photo is kept in ``folder``."""

    def __init__(self, devices: CameraAndDisplay, config: RigConfig, folder: CalibrationFolder) -> None:
        self._devices = devices
        self._config = config
        self._folder = folder
        self._frame_id = 0
        self._commanded_s = 0.0
        self.acknowledged_s: list[float] = []
        self.settings: dict[str, str] = {}

    def set(self, settings: dict[str, str]) -> None:
        """Set the camera and read it back; without settings it is only read."""
        if settings:
            self._devices.camera.apply_settings(settings)
        self.settings = self._devices.camera.settings()

    def wait(self, duration_s: float) -> None:
        """Let time pass."""
        self._devices.clock.sleep_s(duration_s)

    def show_level(self, level: int) -> None:
        """Fill the display with one drive level; returns when the display says that it is done."""
        self.show(Frame(axis="x", levels=np.full(self._config.display.columns, level, dtype=np.uint8)))

    def show(self, frame: Frame) -> None:
        """Show any frame; returns when the display says that it is done."""
        clock, display = self._devices.clock, self._devices.display
        if display is None:
            raise ConfigError("no display was opened, so it cannot show anything; name one in the section [devices]")
        self._frame_id = (self._frame_id + 1) % (LARGEST_FRAME_ID + 1)
        self._commanded_s = clock.now_s()
        display.show(frame, frame_id=self._frame_id, timeout_s=SHOW_TIMEOUT_S)
        self.acknowledged_s.append(clock.now_s() - self._commanded_s)

    def take(self, shows: str, *, after_s: float = 0.0, primary: str | None = None, **facts: object) -> Taken:
        """Photograph what is shown, no sooner than ``after_s`` after it was commanded, and keep the photo.

        It is decoded in the colour ``primary``, the display's where none is given; ``facts`` go into its journal line.
        """
        clock = self._devices.clock
        clock.sleep_s(self._commanded_s + after_s - clock.now_s())
        opened_s = clock.now_s()
        self._devices.camera.expose(timeout_s=PHOTO_TIMEOUT_S)
        files = self._devices.camera.collect(timeout_s=PHOTO_TIMEOUT_S)
        since_s = opened_s - self._commanded_s
        name = self._folder.save(
            files, shows=shows, opened_s=opened_s, after_s=since_s, settings=self.settings, **facts
        )
        file = next((file for file in files if file.suffix.lower() in DECODABLE), None)
        if file is None:
            raise DeviceProtocolError(
                f"camera: {', '.join(file.suffix for file in files) or 'nothing'} came for a photo; let it save a JPEG too"
            )
        said = exposure_of_jpeg(file.data).time_s
        return Taken(
            grey=decode_grey(file.data, Path(file.name or shows), primary=primary or self._config.display.primary),
            opened_s=opened_s,
            after_s=since_s,
            exposure_s=said or exposure_of_settings(self.settings).time_s,
            file=file,
            name=name,
        )
