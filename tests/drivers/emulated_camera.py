"""A numbered photo for each shutter release, so that a test can say which one it got."""

import struct
from itertools import count

import numpy as np
import simplejpeg

from sim_backend.ptpip.world_photos import numbered


class NumberedPhotos:
    """Photographs grey noise; remembers every file that it gave, in ``given``."""

    def __init__(self, *, columns: int = 320, rows: int = 240) -> None:
        grey = np.random.default_rng(1).integers(0, 256, (rows, columns, 1), dtype=np.uint8)
        self._picture = simplejpeg.encode_jpeg(grey, quality=90, colorspace="GRAY")
        self._numbers = count(1)
        self.given: list[bytes] = []

    def __call__(self) -> bytes:
        self.given.append(numbered(self._picture, next(self._numbers)))
        return self.given[-1]


def without_exif(data: bytes) -> bytes:
    """Return a JPEG file without the segment that the camera's body put behind its start."""
    assert data[2:4] == b"\xff\xe1"
    (length,) = struct.unpack_from(">H", data, 4)
    return data[:2] + data[4 + length :]
