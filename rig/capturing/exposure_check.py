"""Was a photo exposed as its set? The Exif of its JPEG is compared with the settings that the camera was frozen with.

What the file or the settings leave out is not compared.
"""

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from PIL import Image, UnidentifiedImageError

from drivers.errors import DeviceProtocolError
from drivers.exposure_time import seconds_of
from drivers.protocols import Photo

JPEG_SUFFIXES = (".jpg", ".jpeg")
# What cameras call these settings; the last name is the simulated camera's.
TIME_NAMES, F_NUMBER_NAMES = ("shutterspeed", "shutter"), ("aperture", "f-number")
# Exif 2.3, table 8: the private directory, and three of its tags.
EXIF_DIRECTORY, EXPOSURE_TIME, F_NUMBER, SENSITIVITY = 0x8769, 0x829A, 0x829D, 0x8827
# Cameras step by a third of a stop and round what they write (1/60 for 1/64): half a step tells two settings apart.
TOLERANCE_STOPS = 1 / 6


@dataclass(frozen=True, slots=True)
class Exposure:
    """Exposure time in seconds, f-number, ISO sensitivity; None for what is not known."""

    time_s: float | None
    f_number: float | None
    iso: float | None


def exposure_of_settings(settings: Mapping[str, str]) -> Exposure:
    """Return the exposure that a camera's settings ask for."""
    time = next((settings[name] for name in TIME_NAMES if name in settings), "")
    f_number = next((settings[name] for name in F_NUMBER_NAMES if name in settings), "")
    return Exposure(seconds_of(time), _number(f_number.lower().removeprefix("f/")), _number(settings.get("iso", "")))


def exposure_of_jpeg(data: bytes) -> Exposure:
    """Return the exposure that a JPEG file says of itself."""
    try:
        with Image.open(io.BytesIO(data)) as picture:
            tags = picture.getexif().get_ifd(EXIF_DIRECTORY)
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError):  # that it is whole is checked elsewhere
        return Exposure(None, None, None)
    return Exposure(*(_number(tags.get(tag)) for tag in (EXPOSURE_TIME, F_NUMBER, SENSITIVITY)))


def check_exposure(files: tuple[Photo, ...], settings: Mapping[str, str], *, name: str) -> None:
    """Compare the JPEG of a photo with the settings of its set.

    Raises
    ------
    DeviceProtocolError
        The photo was exposed otherwise; it is not to be kept.
    """
    wanted = exposure_of_settings(settings)
    for file in files:
        if file.suffix.lower() not in JPEG_SUFFIXES:
            continue
        found = exposure_of_jpeg(file.data)
        for what, unit, asked, seen, stops_a_doubling in (
            ("exposure time", " s", wanted.time_s, found.time_s, 1),
            ("f-number", "", wanted.f_number, found.f_number, 2),
            ("ISO sensitivity", "", wanted.iso, found.iso, 1),
        ):
            if asked and seen and abs(math.log2(seen / asked)) * stops_a_doubling > TOLERANCE_STOPS:
                raise DeviceProtocolError(
                    f"camera: {name} has an {what} of {seen:.4g}{unit}, its set was begun with {asked:.4g}{unit}; "
                    "keep hands off the camera's dials, turn them back, and resume"
                )


def _number(value: Any) -> float | None:
    """Return a positive number, from text or from an Exif value; a sensitivity may be several, of which the first counts."""
    if isinstance(value, tuple):
        value = value[0] if value else None
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None
