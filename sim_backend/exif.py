"""The exposure that a camera writes into its JPEG files, as in the Exif standard (CIPA DC-008, sections 4.6 and 4.7).

Written from the standard with nothing but packing, so that a reader of ours has something independent to read.
"""

import struct
from dataclasses import dataclass
from fractions import Fraction

START_OF_IMAGE, APPLICATION_SEGMENT_1 = b"\xff\xd8", b"\xff\xe1"
EXIF_POINTER, EXPOSURE_TIME, F_NUMBER, SENSITIVITY, EXIF_VERSION = 0x8769, 0x829A, 0x829D, 0x8827, 0x9000
SHORT, LONG, RATIONAL, UNDEFINED = 3, 4, 5, 7
DIRECTORY_START = 8  # behind the TIFF header
# A directory is its count, twelve bytes an entry, and the place of the next one (none).
ONE_ENTRY_BYTES, FOUR_ENTRIES_BYTES = 2 + 12 + 4, 2 + 4 * 12 + 4


@dataclass(frozen=True, slots=True)
class Exposure:
    """Exposure time in seconds, f-number and ISO sensitivity, as exact as the camera knows them."""

    time_s: Fraction
    f_number: Fraction
    iso: int


def exif_segment(exposure: Exposure) -> bytes:
    """Return the APP1 segment of a JPEG file that says how it was exposed."""
    exif_start = DIRECTORY_START + ONE_ENTRY_BYTES
    values_start = exif_start + FOUR_ENTRIES_BYTES
    main = struct.pack("<H", 1) + _entry(EXIF_POINTER, LONG, 1, exif_start) + struct.pack("<I", 0)
    exif = (
        struct.pack("<H", 4)
        + _entry(EXPOSURE_TIME, RATIONAL, 1, values_start)
        + _entry(F_NUMBER, RATIONAL, 1, values_start + 8)
        + _entry(SENSITIVITY, SHORT, 1, exposure.iso)
        + struct.pack("<HHI4s", EXIF_VERSION, UNDEFINED, 4, b"0230")
        + struct.pack("<I", 0)
    )
    values = struct.pack("<4I", *exposure.time_s.as_integer_ratio(), *exposure.f_number.as_integer_ratio())
    tiff = b"II*\0" + struct.pack("<I", DIRECTORY_START) + main + exif + values
    payload = b"Exif\0\0" + tiff
    return APPLICATION_SEGMENT_1 + struct.pack(">H", 2 + len(payload)) + payload


def _entry(tag: int, kind: int, count: int, value: int) -> bytes:
    return struct.pack("<HHII", tag, kind, count, value)


def with_exif(jpeg: bytes, exposure: Exposure) -> bytes:
    """Return a JPEG file that says how it was exposed, directly behind its start; what is no JPEG stays as it is."""
    if not jpeg.startswith(START_OF_IMAGE + b"\xff"):
        return jpeg
    return START_OF_IMAGE + exif_segment(exposure) + jpeg[len(START_OF_IMAGE) :]
