"""What a sensor gets while the shutter is open.

The world is looked at when the shutter opens and when it closes. Where the display shows another frame by then, half of the
light is that of the first one: the photo shows both, and a frame tag in it belongs to neither.
"""

from typing import Protocol, runtime_checkable

import numpy as np
import simplejpeg

from drivers.protocols import Frame
from sim_backend.disturbance import QUIET, Disturbance
from sim_backend.frame_equality import same_frame
from sim_backend.world import Sight, World

BLEND_QUALITY = 95


@runtime_checkable
class TakesPhotos(Protocol):
    """The optics behind a camera: :class:`sim_backend.photography.Photographer`, or a stand-in."""

    def photograph(
        self,
        frame: Frame,
        *,
        stage_position_mm: float,
        wet: bool,
        object_present: bool = True,
        disturbance: Disturbance = QUIET,
    ) -> bytes:
        """Return the JPEG file of one photo."""
        ...


class WorldExposure:
    """One sensor in front of ``world``, behind ``optics``; one exposure at a time."""

    def __init__(self, world: World, optics: TakesPhotos) -> None:
        self._world = world
        self._optics = optics
        self._opened_on: Frame | None = None
        self._seen: tuple[Sight, Frame | None] | None = None

    def open_shutter(self) -> None:
        """Begin to see."""
        self._opened_on = self._world.shown()

    def close_shutter(self) -> None:
        """End to see; the display may change when this returns."""
        before, self._opened_on = self._opened_on, None
        sight = self._world.look(opened_on=before)
        changed = before is not None and not same_frame(before, sight.frame)
        self._seen = (sight, before if changed else None)

    def develop(self) -> bytes:
        """Return the JPEG file of what was seen."""
        assert self._seen is not None, "the shutter was not opened and closed"
        (sight, before), self._seen = self._seen, None
        photo = self._photographed(sight, sight.frame)
        return photo if before is None else blended(self._photographed(sight, before), photo)

    def snap(self) -> bytes:
        """Return the JPEG file of a photo that takes no time, whatever an exposure under way sees."""
        sight = self._world.look()
        return self._photographed(sight, sight.frame)

    def _photographed(self, sight: Sight, frame: Frame) -> bytes:
        return self._optics.photograph(
            frame,
            stage_position_mm=sight.stage_position_mm,
            wet=sight.wet,
            object_present=sight.object_present,
            disturbance=sight.disturbance,
        )


def blended(one: bytes, other: bytes) -> bytes:
    """Return the JPEG file of a photo that got half of its light as in each of two grey ones."""
    halves = [simplejpeg.decode_jpeg(file, colorspace="GRAY").astype(np.uint16) for file in (one, other)]
    both = ((halves[0] + halves[1] + 1) // 2).astype(np.uint8)
    return simplejpeg.encode_jpeg(both, quality=BLEND_QUALITY, colorspace="GRAY")
