"""What a sensor gets while the shutter is open.

The world is looked at when the shutter opens and when it closes. Where the display shows another frame by then, half of the
light is that of the first one: the photo shows both, and a frame tag in it belongs to neither.

Where the scene's display changes with time, each row of the photo gets each frame for as long as it was lit while the row was
open, as bright as the display was then (:mod:`sim_backend.brightness`).
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import simplejpeg
from jaxtyping import Float64

from drivers.protocols import Frame
from sim_backend.brightness import light_got, opening_times_s
from sim_backend.disturbance import QUIET, Disturbance
from sim_backend.frame_equality import same_frame
from sim_backend.held_sheet import HeldSheet
from sim_backend.scene import Scene
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
        light: float = 1.0,
    ) -> bytes:
        """Return the JPEG file of one photo; ``light`` is how many times the scene's own exposure reaches the sensor."""
        ...


@runtime_checkable
class MixesFrames(TakesPhotos, Protocol):
    """Optics that know the scene, and can photograph several frames in one exposure."""

    @property
    def scene(self) -> Scene:
        """What is in front of the camera."""
        ...

    def photograph_mix(
        self,
        frames: Sequence[Frame],
        shares: Sequence[Float64[np.ndarray, " rows"]],
        *,
        opened_s: float,
        stage_position_mm: float,
        wet: bool,
        object_present: bool = True,
        disturbance: Disturbance = QUIET,
        light: float = 1.0,
    ) -> bytes:
        """Return the JPEG file of one photo, of which each row got its share of each frame's light."""
        ...


@runtime_checkable
class SeesHeldSheets(TakesPhotos, Protocol):
    """Optics that can photograph what a hand holds before the camera."""

    def photograph_held(self, held: HeldSheet, frame: Frame, *, exposure: int = 0, light: float = 1.0) -> bytes:
        """Return the JPEG file of one photo; ``exposure`` numbers photos whose noise is to differ."""
        ...


class WorldExposure:
    """One sensor in front of ``world``, behind ``optics``; one exposure at a time."""

    def __init__(self, world: World, optics: TakesPhotos) -> None:
        self._world = world
        self._optics = optics
        timed = isinstance(optics, MixesFrames) and optics.scene.display.changes_with_time
        self._mixing: MixesFrames | None = optics if isinstance(optics, MixesFrames) and timed else None
        self._opened_on: Frame | None = None
        self._opened_s = 0.0
        self._seen: tuple[Sight, Frame | None] | None = None
        self._spans: tuple[float, tuple[tuple[float, float, Frame], ...]] = (0.0, ())

    def lasts_s(self, shutter_s: float) -> float | None:
        """Return how long a shutter set to ``shutter_s`` is open for all rows together; None where it does not matter."""
        return None if self._mixing is None else shutter_s + self._mixing.scene.camera.readout_s

    def open_shutter(self) -> None:
        """Begin to see."""
        self._opened_on = self._world.shown()
        self._opened_s = self._world.clock.now_s()

    def close_shutter(self) -> None:
        """End to see; the display may change when this returns."""
        before, self._opened_on = self._opened_on, None
        sight = self._world.look(opened_on=before)
        changed = before is not None and not same_frame(before, sight.frame)
        self._seen = (sight, before if changed else None)
        closed_s = self._world.clock.now_s()
        self._spans = (closed_s, self._world.shown_between(self._opened_s, closed_s))

    def develop(self, *, light: float = 1.0) -> bytes:
        """Return the JPEG file of what was seen, with so many times the light of the scene's own exposure."""
        assert self._seen is not None, "the shutter was not opened and closed"
        (sight, before), self._seen = self._seen, None
        if self._mixing is not None and sight.held is None:
            return self._mixed(self._mixing, sight, light)
        photo = self._photographed(sight, sight.frame, light)
        return photo if before is None else blended(self._photographed(sight, before, light), photo)

    def snap(self) -> bytes:
        """Return the JPEG file of a photo that takes no time, whatever an exposure under way sees."""
        sight = self._world.look()
        return self._photographed(sight, sight.frame, 1.0)

    def _mixed(self, optics: MixesFrames, sight: Sight, light: float) -> bytes:
        camera, display = optics.scene.camera, optics.scene.display
        closed_s, spans = self._spans
        exposure_s = max(0.0, closed_s - self._opened_s - camera.readout_s)
        rows_open_s = opening_times_s(camera, self._opened_s)
        # What is on the glass at the end stays there: a row must not lose light to the rounding of a sum of times.
        until_s = [*(end_s for _, end_s, _ in spans[:-1]), np.inf]
        return optics.photograph_mix(
            [frame for _, _, frame in spans],
            [
                light_got(display, rows_open_s, exposure_s, first_s=first_s, last_s=last_s)
                for (first_s, _, _), last_s in zip(spans, until_s, strict=True)
            ],
            opened_s=self._opened_s,
            stage_position_mm=sight.stage_position_mm,
            wet=sight.wet,
            object_present=sight.object_present,
            disturbance=sight.disturbance,
            light=light,
        )

    def _photographed(self, sight: Sight, frame: Frame, light: float) -> bytes:
        if sight.held is not None and isinstance(self._optics, SeesHeldSheets):
            if sight.held.printed is None:
                light *= sight.disturbance.light
            return self._optics.photograph_held(sight.held, frame, exposure=sight.disturbance.exposure, light=light)
        return self._optics.photograph(
            frame,
            stage_position_mm=sight.stage_position_mm,
            wet=sight.wet,
            object_present=sight.object_present,
            disturbance=sight.disturbance,
            light=light,
        )


def blended(one: bytes, other: bytes) -> bytes:
    """Return the JPEG file of a photo that got half of its light as in each of two grey ones."""
    halves = [simplejpeg.decode_jpeg(file, colorspace="GRAY").astype(np.uint16) for file in (one, other)]
    both = ((halves[0] + halves[1] + 1) // 2).astype(np.uint8)
    return simplejpeg.encode_jpeg(both, quality=BLEND_QUALITY, colorspace="GRAY")
