"""Photographs of a scene: what the camera sees when the display shows a frame."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float32, Float64

from drivers.protocols import Frame
from sim_backend.display_bubbles import through_display_bubbles
from sim_backend.disturbance import QUIET, Disturbance, disturbed_scene, rippled
from sim_backend.footprint import axis_matrix, image_light, light_of, middles_of_light, patch_matrix
from sim_backend.held_sheet import Directions, HeldSheet, sheet_light, straight_rays
from sim_backend.light_paths import ScreenMap, SubRays, on_panel, screen_map, trace_sub_rays
from sim_backend.marks import mark_light
from sim_backend.scene import Scene
from sim_backend.sensor import blur, frame_key, grey_levels, jpeg_bytes, noisy_grey
from sim_backend.truth import Truth, compute_truth, save_truth

__all__ = ["Photographer", "Truth", "save_truth"]

Values = Float32[np.ndarray, "rows columns"]
Key = tuple[float, bool, bool, Disturbance]

# Views kept at once: the four capture sets and two places on the way.
VIEWS_KEPT = 6

# Beyond this share of lit columns one matrix product beats adding them one at a time.
MANY_COLUMNS = 1 / 8


@dataclass(slots=True, eq=False)
class View:
    """The display at one place, seen through one world, with the matrices made so far.

    ``colours`` holds for each colour of the light its weight and where its rays meet the display; ``marks`` what printed
    marks cover and send.
    """

    colours: tuple[tuple[float, ScreenMap], ...]
    marks: tuple[Values, Values] | None = None
    axes: dict[str, sp.csc_matrix] = field(default_factory=dict)
    patches: dict[tuple[int, int, int, int], sp.csr_matrix] = field(default_factory=dict)


class Photographer:
    """Takes photos of a scene; safe to use from several threads.

    Tracing happens at the first photo of each kind and is remembered. The noise of a photo depends only on the
    scene's seed, the display's place, the liquid, the object and the frame: the same photo again is the same bytes. A
    disturbance changes all of it; by default there is none.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._lock = threading.RLock()
        self._rays: OrderedDict[tuple[bool, bool, Disturbance], Any] = OrderedDict()
        self._views: OrderedDict[Key, View] = OrderedDict()
        self._straight: dict[str, Directions] = {}

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
        """Return the JPEG of one exposure; ``light`` is how many times the scene's own exposure reaches the sensor."""
        value = self._value(frame, (float(stage_position_mm), wet, object_present, disturbance))
        camera = self.scene.camera
        parts: tuple[object, ...] = () if disturbance == QUIET else (disturbance,)
        if light != 1:
            value = value * np.float32(light)
            parts = (*parts, light)
        key = frame_key(frame, self.scene.seed, float(stage_position_mm), wet, object_present, *parts)
        return jpeg_bytes(noisy_grey(value, camera, key=key), quality=camera.jpeg_quality)

    def photograph_held(self, held: HeldSheet, frame: Frame, *, exposure: int = 0, light: float = 1.0) -> bytes:
        """Return the JPEG of one exposure of what a hand holds before the camera."""
        camera = self.scene.camera
        direction = self._made(self._straight, "camera", lambda: straight_rays(camera))
        value = blur(sheet_light(self.scene, held, frame, direction), camera.blur_px)
        value = (value + np.float32(camera.ambient)) * np.float32(light)
        key = frame_key(frame, self.scene.seed, *held.key(), exposure, light)
        return jpeg_bytes(noisy_grey(value, camera, key=key), quality=camera.jpeg_quality)

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
        """Return the JPEG of one exposure during which the display showed ``frames``.

        Each row of the photo gets its share of each frame's light. Rows are weighted before the lens blurs them: shares change
        over hundreds of rows, blur reaches over a few. Exposures at different times have noise of their own.
        """
        key = (float(stage_position_mm), wet, object_present, disturbance)
        view = self._view(key)
        camera = self.scene.camera
        got = np.zeros((camera.rows, camera.columns), np.float32)
        for frame, share in zip(frames, shares, strict=True):
            got += share[:, None].astype(np.float32) * self._light(view, frame)
        number = frame_key(frames[-1], self.scene.seed, *key, opened_s, [frame_key(frame) for frame in frames[:-1]])
        seen = self._seen(view, got, disturbance)
        if light != 1:
            seen = seen * np.float32(light)
        return jpeg_bytes(noisy_grey(seen, camera, key=number), quality=camera.jpeg_quality)

    def expected(
        self,
        frame: Frame,
        *,
        stage_position_mm: float,
        wet: bool,
        object_present: bool = True,
        disturbance: Disturbance = QUIET,
    ) -> Values:
        """Return the photo's grey levels, 0 to 255, without noise, rounding or JPEG."""
        value = self._value(frame, (float(stage_position_mm), wet, object_present, disturbance))
        return grey_levels(value, self.scene.camera)

    def pixel_coordinates(
        self, *, stage_position_mm: float, wet: bool, object_present: bool = True, disturbance: Disturbance = QUIET
    ) -> Float64[np.ndarray, "rows columns 2"]:
        """Return the mean device pixel (column, row) that each camera pixel sees, weighted by light; NaN where unlit."""
        camera = self.scene.camera
        total = np.zeros((camera.rows, camera.columns))
        moment = np.zeros((camera.rows, camera.columns, 2))
        for share, places in self._view((float(stage_position_mm), wet, object_present, disturbance)).colours:
            lit = on_panel(self.scene, places.column_px, places.row_px)
            weight = np.where(lit, share * places.transmission.astype(np.float64), 0.0)
            total += self._pixel_sums(weight)
            for number, place in enumerate((places.column_px, places.row_px)):
                moment[..., number] += self._pixel_sums(np.where(lit, weight * place, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            return moment / total[..., None]

    def truth(self) -> Truth:
        """Return the true point and normal behind the centre of each pixel."""
        return compute_truth(self.scene)

    def _pixel_sums(self, fine: np.ndarray) -> np.ndarray:
        camera, fold = self.scene.camera, self.scene.camera.supersampling
        return fine.reshape(camera.rows, fold, camera.columns, fold).sum(axis=(1, 3))

    def _view(self, key: Key) -> View:
        stage_position_mm, wet, object_present, disturbance = key
        key = (stage_position_mm, wet, object_present, disturbance.of_paths())
        with self._lock:
            if key not in self._views:
                scene = disturbed_scene(self.scene, disturbance)
                rays = self._traced(scene, wet, object_present, disturbance)
                marks_moved = self.scene.marks is not None and self.scene.marks.fixed_to == "holder"
                marks = mark_light(scene, shift_mm=disturbance.object_shift_mm if marks_moved else (0.0, 0.0))
                if wet:
                    rays = tuple(
                        (weight, through_display_bubbles(scene, each, stage_position_mm)) for weight, each in rays
                    )
                colours = tuple(
                    (weight, middles_of_light(screen_map(scene, each, stage_position_mm))) for weight, each in rays
                )
                self._views[key] = View(colours, marks)
                while len(self._views) > VIEWS_KEPT:
                    self._views.popitem(last=False)
            self._views.move_to_end(key)
            return self._views[key]

    def _traced(
        self, scene: Scene, wet: bool, object_present: bool, disturbance: Disturbance
    ) -> tuple[tuple[float, SubRays], ...]:
        key = (wet, object_present, disturbance.before_the_surface())
        rays = self._made(self._rays, key, lambda: self._trace(scene, wet, object_present, disturbance))
        while len(self._rays) > VIEWS_KEPT:
            self._rays.popitem(last=False)
        camera_mm = np.array(scene.camera.position_mm)
        if not wet:
            return rays
        return tuple(
            (weight, rippled(each, disturbance, camera_mm=camera_mm, n_air=scene.n_air)) for weight, each in rays
        )

    def _trace(
        self, scene: Scene, wet: bool, object_present: bool, disturbance: Disturbance
    ) -> tuple[tuple[float, SubRays], ...]:
        worlds = [
            (line.weight, scene.world(wet=wet, object_present=object_present, line=line)) for line in scene.spectrum()
        ]
        moved = scene.object_shift_mm(wet=wet and object_present)
        shift_mm = (moved[0] + disturbance.object_shift_mm[0], moved[1] + disturbance.object_shift_mm[1], moved[2])
        return tuple((weight, trace_sub_rays(scene, world, object_shift_mm=shift_mm)) for weight, world in worlds)

    def _made(self, store: dict[Any, Any], key: object, make: Callable[[], Any]) -> Any:
        if key not in store:
            with self._lock:
                if key not in store:
                    store[key] = make()
        return store[key]

    def _axis_matrix(self, view: View, axis: str) -> sp.csc_matrix:
        panel = self.scene.display
        along, across = (panel.columns, panel.rows) if axis == "x" else (panel.rows, panel.columns)
        return self._made(
            view.axes,
            axis,
            lambda: _weighted_sum(
                (
                    weight,
                    axis_matrix(
                        places,
                        axis,
                        supersampling=self.scene.camera.supersampling,
                        device_px=along,
                        across_px=across,
                    ),
                )
                for weight, places in view.colours
            ),
        )

    def _value(self, frame: Frame, key: Key) -> Values:
        """Return the expected share of full scale in each pixel."""
        view = self._view(key)
        return self._seen(view, self._light(view, frame), key[-1])

    def _light(self, view: View, frame: Frame) -> Values:
        """Return the light of the display in each pixel, 1 where it is fully lit and nothing is lost on the way."""
        self._check(frame)
        if frame.image is not None:
            light = self._image_light(view, frame)
        else:
            light = self._stripe_light(view, frame)
            light += self._patch_light(view, frame)
        return light.reshape(self.scene.camera.rows, self.scene.camera.columns)

    def _seen(self, view: View, light: Values, disturbance: Disturbance) -> Values:
        """Return what the lens and the room make of the display's light; ``light`` is used up."""
        camera = self.scene.camera
        dimmed = np.float32(camera.signal * disturbance.light)
        if view.marks is not None:
            covered, sent = view.marks
            light = blur(light * (1 - covered) * dimmed + sent, camera.blur_px)
            return light + np.float32(camera.ambient)
        light = blur(light, camera.blur_px)
        light *= dimmed
        light += np.float32(camera.ambient)
        return light

    def _check(self, frame: Frame) -> None:
        panel = self.scene.display
        if (frame.image is None) == (frame.levels is None):
            raise ValueError("a frame holds either levels along an axis or a whole image, and this one does not")
        if frame.image is not None and frame.image.shape != (panel.rows, panel.columns):
            raise ValueError(f"image of {frame.image.shape} asked, the panel has {(panel.rows, panel.columns)} pixels")
        if frame.levels is not None:
            along = panel.columns if frame.axis == "x" else panel.rows
            if frame.axis not in ("x", "y") or frame.levels.shape != (along,):
                raise ValueError(
                    f"{frame.levels.shape[0]} levels along {frame.axis!r} asked, the panel has {along} there"
                )

    def _stripe_light(self, view: View, frame: Frame) -> Float32[np.ndarray, " pixels"]:
        assert frame.axis is not None  # checked on entry
        assert frame.levels is not None
        matrix = self._axis_matrix(view, frame.axis)
        levels = light_of(frame.levels, self.scene.display.gamma)
        lit = np.flatnonzero(levels)
        if len(lit) > MANY_COLUMNS * len(levels):
            return matrix @ levels
        light = np.zeros(matrix.shape[0], np.float32)
        for column in lit:
            part = slice(matrix.indptr[column], matrix.indptr[column + 1])
            light[matrix.indices[part]] += matrix.data[part] * levels[column]
        return light

    def _patch_light(self, view: View, frame: Frame) -> Float32[np.ndarray, " pixels"] | np.float32:
        """Return what the patches add to the stripe under them; later patches cover earlier ones."""
        if not frame.patches:
            return np.float32(0)
        left = max(0, min(patch.column for patch in frame.patches))
        top = max(0, min(patch.row for patch in frame.patches))
        right = min(self.scene.display.columns, max(p.column + p.levels.shape[1] for p in frame.patches))
        bottom = min(self.scene.display.rows, max(p.row + p.levels.shape[0] for p in frame.patches))
        if right <= left or bottom <= top:
            return np.float32(0)
        assert frame.levels is not None  # checked on entry
        gamma = self.scene.display.gamma
        if frame.axis == "x":
            under = np.broadcast_to(frame.levels[left:right], (bottom - top, right - left))
        else:
            under = np.broadcast_to(frame.levels[top:bottom, None], (bottom - top, right - left))
        shown = _with_patches(under, frame, left, top)
        matrix = self._made(
            view.patches,
            (left, top, right, bottom),
            lambda: _weighted_sum(
                (
                    weight,
                    patch_matrix(
                        places,
                        column=left,
                        row=top,
                        columns=right - left,
                        rows=bottom - top,
                        supersampling=self.scene.camera.supersampling,
                    ),
                )
                for weight, places in view.colours
            ),
        )
        return matrix @ (light_of(shown, gamma) - light_of(under, gamma)).ravel()

    def _image_light(self, view: View, frame: Frame) -> Values:
        assert frame.image is not None  # checked on entry
        light = light_of(_with_patches(frame.image, frame, 0, 0), self.scene.display.gamma)
        total = np.zeros((self.scene.camera.rows, self.scene.camera.columns), np.float32)
        for weight, places in view.colours:
            gathered = image_light(places, light, supersampling=self.scene.camera.supersampling)
            total += np.float32(weight) * gathered
        return total


def _weighted_sum(parts: Iterable[tuple[float, Any]]) -> Any:
    """Add sparse matrices of the colours, each with its weight."""
    return reduce(add, (matrix if weight == 1 else matrix * np.float32(weight) for weight, matrix in parts))


def _with_patches(under: np.ndarray, frame: Frame, left: int, top: int) -> np.ndarray:
    """Draw a frame's patches over a part of the panel whose first pixel is (left, top); what sticks out is cut off."""
    shown = under.copy()
    rows, columns = shown.shape
    for patch in frame.patches:
        first_row, first_column = patch.row - top, patch.column - left
        height, width = patch.levels.shape
        low_row, high_row = max(first_row, 0), min(first_row + height, rows)
        low_column, high_column = max(first_column, 0), min(first_column + width, columns)
        if low_row < high_row and low_column < high_column:
            shown[low_row:high_row, low_column:high_column] = patch.levels[
                low_row - first_row : high_row - first_row, low_column - first_column : high_column - first_column
            ]
    return shown
