"""Compares the frame number in a photo with the one that was commanded, before the photo is saved."""

from pathlib import Path

import numpy as np

from drivers.protocols import Photo
from recon.patterns.frame_tag_reading import TagReading, find_tag, read_tag
from recon.sessions.photos import decode_grey
from rig.capturing.frames import tag_number
from rig.config import RigConfig
from rig.errors import CaptureError, WrongFrameError
from rig.planning.steps import TakePhoto

DECODABLE = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


class TagCheck:
    """Remembers from photo to photo of a set where the tag is: display and liquid move it between sets only."""

    def __init__(self, config: RigConfig) -> None:
        self._primary = config.display.primary
        self._seen_px = config.frame_tag.seen_px if config.frame_tag else None
        self._corners_px: dict[str, np.ndarray] = {}

    def check(self, photo: TakePhoto, files: tuple[Photo, ...]) -> int | None:
        """Return the number that the photo shows, None where no tag is to be read.

        Raises
        ------
        WrongFrameError
            The photo shows another frame than ``photo``, or the number cannot be read.
        CaptureError
            None of the files can be decoded.
        """
        if self._seen_px is None:
            return None
        name = f"photo {photo.set_name} {photo.sweep} {photo.index}"
        file = next((file for file in files if file.suffix.lower() in DECODABLE), None)
        if file is None:
            raise CaptureError(
                f"{name}: its frame tag cannot be read from {', '.join(file.suffix for file in files)}; let the camera "
                "save a JPEG too, or leave out frame_tag.seen_px"
            )
        grey = decode_grey(file.data, Path(file.name or name), primary=self._primary)
        reading = self._read(grey, photo.set_name)
        if reading is None or reading.number is None:
            why = f" ({reading.fault})" if reading else ""
            raise WrongFrameError(
                f"{name}: the frame tag cannot be read{why}; look at what covers or darkens it in the photo, or correct "
                "frame_tag.seen_px, then resume"
            )
        self._corners_px[photo.set_name] = reading.corners_px
        commanded = tag_number(photo.frame_id)
        if reading.number != commanded:
            raise WrongFrameError(
                f"{name}: it shows frame {reading.number}, frame {commanded} was commanded, so it was not saved; "
                "raise timing.settle_s, let nobody else release the shutter, then resume"
            )
        return reading.number

    def _read(self, grey: np.ndarray, set_name: str) -> TagReading | None:
        """Read the tag where it was in the last photo of the set, or look for it where the configuration says."""
        assert self._seen_px is not None  # checked by the caller
        full_scale = float(np.iinfo(grey.dtype).max)
        if set_name in self._corners_px:
            reading = read_tag(grey, self._corners_px[set_name], full_scale=full_scale)
            if reading.number is not None:
                return reading
        left, top, right, bottom = (round(edge_px) for edge_px in self._seen_px)
        found = find_tag(grey[top : bottom + 1, left : right + 1], full_scale=full_scale)
        return found.moved(left, top) if found else None
