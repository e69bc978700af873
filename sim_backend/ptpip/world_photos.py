"""Photos of the shared world for an emulated camera."""

import struct
from itertools import count

from sim_backend.exposure import TakesPhotos, WorldExposure
from sim_backend.world import World

COMMENT = b"\xff\xfe"
START_OF_IMAGE, APPLICATION_DATA = b"\xff\xd8", b"\xff\xe0"


class WorldPhotos:
    """Photographs ``world`` through ``optics``; it is what :func:`sim_backend.ptpip.process.emulate_camera` asks for photos.

    Implements :class:`sim_backend.ptpip.sources.Exposing`.
    """

    def __init__(self, world: World, optics: TakesPhotos) -> None:
        self._exposure = WorldExposure(world, optics)
        self._numbers = count(1)

    def open_shutter(self) -> None:
        """Begin to see."""
        self._exposure.open_shutter()

    def close_shutter(self) -> None:
        """End to see."""
        self._exposure.close_shutter()

    def develop(self) -> bytes:
        """Return the file of what was seen."""
        return numbered(self._exposure.develop(), next(self._numbers))

    def __call__(self) -> bytes:
        """Return the file of a photo that takes no time."""
        return numbered(self._exposure.snap(), next(self._numbers))


def numbered(data: bytes, number: int) -> bytes:
    """Return a JPEG file with a comment that carries ``number``, behind its first application segment.

    Two files of a real camera always differ, in their date and their noise; simulated ones of the same scene need not.
    """
    place = len(START_OF_IMAGE)
    if data[place : place + 2] == APPLICATION_DATA:
        (length,) = struct.unpack_from(">H", data, place + 2)
        place += 2 + length
    text = f"photo {number}".encode("ascii")
    return data[:place] + COMMENT + struct.pack(">H", 2 + len(text)) + text + data[place:]
