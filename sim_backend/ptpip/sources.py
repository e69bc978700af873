"""Where an emulated camera's photos come from.

A camera that runs by itself has those of a folder, in turn, or drawn ones that carry their number.
"""

from collections.abc import Callable
from itertools import count, cycle
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import simplejpeg

from drivers.errors import DeviceNotFoundError

DRAWN_COLUMNS, DRAWN_ROWS = 648, 432
# Returns the whole file of a photo that takes no time.
Photographs = Callable[[], bytes]


@runtime_checkable
class Exposing(Protocol):
    """Photographs that know how long their shutter is open: a frame that changes meanwhile is in the photo twice."""

    def open_shutter(self) -> None:
        """Begin to see."""
        ...

    def close_shutter(self) -> None:
        """End to see; what is shown may change when this returns."""
        ...

    def develop(self) -> bytes:
        """Return the file of what was seen."""
        ...

    def __call__(self) -> bytes:
        """Return the file of a photo that takes no time, whatever an exposure under way sees."""
        ...


class Instant:
    """Makes photos that take no time of a function that returns them."""

    def __init__(self, photographs: Photographs) -> None:
        self._photographs = photographs

    def open_shutter(self) -> None:
        """There is nothing that could change."""

    def close_shutter(self) -> None:
        """There is nothing that could change."""

    def develop(self) -> bytes:
        """Return the file of the next photo."""
        return self._photographs()

    def __call__(self) -> bytes:
        """Return the file of the next photo."""
        return self._photographs()


def as_exposing(photographs: Photographs) -> Exposing:
    """Return ``photographs`` itself where it knows of its shutter."""
    return photographs if isinstance(photographs, Exposing) else Instant(photographs)


def photos_of_folder(folder: Path) -> Callable[[], bytes]:
    """Return a source that gives the JPEG files of ``folder`` in the order of their names, again and again."""
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in (".jpg", ".jpeg"))
    if not files:
        raise DeviceNotFoundError(f"{folder}: no JPEG file in it; name a folder of photos")
    turn = cycle(files)
    return lambda: next(turn).read_bytes()


def drawn_photos() -> Callable[[], bytes]:
    """Return a source of grey photos, each with its number on it and noise of its own."""
    numbers = count(1)

    def draw() -> bytes:
        number = next(numbers)
        noise = np.random.default_rng(number).integers(110, 146, (DRAWN_ROWS, DRAWN_COLUMNS, 1), dtype=np.uint8)
        place = (40, DRAWN_ROWS // 2 + 30)
        cv2.putText(noise, f"photo {number}", place, cv2.FONT_HERSHEY_SIMPLEX, 3.0, 255, 6)
        return simplejpeg.encode_jpeg(noise, quality=90, colorspace="GRAY")

    return draw
