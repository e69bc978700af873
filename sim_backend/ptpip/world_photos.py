"""Photos of the shared world for an emulated camera."""

import struct
from itertools import count

from sim_backend.camera import TakesPhotos
from sim_backend.world import World

COMMENT = b"\xff\xfe"
START_OF_IMAGE, APPLICATION_DATA = b"\xff\xd8", b"\xff\xe0"


class WorldPhotos:
    """Photographs ``world`` through ``optics`` at the moment of each call.

    It is what :func:`sim_backend.ptpip.process.emulate_camera` asks for photos.
    """

    def __init__(self, world: World, optics: TakesPhotos) -> None:
        self._world = world
        self._optics = optics
        self._numbers = count(1)

    def __call__(self) -> bytes:
        """Return the file of a photo taken now."""
        sight = self._world.look()
        data = self._optics.photograph(
            sight.frame,
            stage_position_mm=sight.stage_position_mm,
            wet=sight.wet,
            object_present=sight.object_present,
        )
        return numbered(data, next(self._numbers))


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
