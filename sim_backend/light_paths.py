"""The paths that the camera sees: rays through a grid of places in each pixel, traced to their last straight piece."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from sim_backend.optics.pinhole import camera_directions
from sim_backend.optics.screen import ScreenHits, hit_screen
from sim_backend.optics.tracer import OpticalWorld, Paths, trace
from sim_backend.scene import Scene, SceneCamera
from sim_backend.scene_parts import Vector

# Rays traced at once: their arrays stay in a core's cache.
CHUNK_RAYS = 16384


@dataclass(frozen=True, slots=True, eq=False)
class SubRays:
    """The last straight piece of every sub-ray, row by row over the fine grid of ``fine_rows`` by ``fine_columns``.

    ``transmission`` is 0 for a ray that found no way out.
    """

    fine_rows: int
    fine_columns: int
    origin: Float64[np.ndarray, "rays 3"]
    direction: Float64[np.ndarray, "rays 3"]
    n: Float64[np.ndarray, " rays"]
    transmission: Float32[np.ndarray, " rays"]
    route: Int64[np.ndarray, " rays"]


@dataclass(frozen=True, slots=True, eq=False)
class ScreenMap:
    """Where on the display each sub-ray ends: device pixels (NaN: nowhere), and the light that is kept."""

    column_px: Float64[np.ndarray, "rows columns"]
    row_px: Float64[np.ndarray, "rows columns"]
    transmission: Float32[np.ndarray, "rows columns"]
    route: Int64[np.ndarray, "rows columns"]


def look(camera: SceneCamera, column: np.ndarray, row: np.ndarray) -> Float64[np.ndarray, "rays 3"]:
    """Return the directions in which a scene's camera looks through places of its photo."""
    return camera_directions(
        column,
        row,
        focal_px=(camera.focal_x_px, camera.focal_y_px),
        centre_px=(camera.centre_x_px, camera.centre_y_px),
        distortion=camera.distortion,
        world_from_camera=camera.world_from_camera(),
    )


def pixel_centre_paths(scene: Scene, world: OpticalWorld, *, object_shift_mm: Vector = (0.0, 0.0, 0.0)) -> Paths:
    """Trace one ray through the centre of each pixel, row by row, in the frame of an object that was shifted."""
    row, column = np.indices((scene.camera.rows, scene.camera.columns)).reshape(2, -1).astype(np.float64)
    direction = look(scene.camera, column, row)
    origin = np.broadcast_to(np.array(scene.camera.position_mm) - object_shift_mm, direction.shape)
    chunks = [slice(start, start + CHUNK_RAYS) for start in range(0, len(column), CHUNK_RAYS)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        parts = list(pool.map(lambda part: trace(world, origin[part], direction[part]), chunks))
    return Paths(*(np.concatenate([getattr(part, name) for part in parts]) for name in Paths.__slots__))


def last_pieces(scene: Scene, paths: Paths, *, object_shift_mm: Vector = (0.0, 0.0, 0.0)) -> SubRays:
    """Return the last pieces of one path a pixel, back in the scene's frame where the object was shifted."""
    kept = np.where(paths.trapped, 0.0, paths.transmission if scene.fresnel else 1.0).astype(np.float32)
    origin = paths.origin + object_shift_mm
    camera = scene.camera
    return SubRays(camera.rows, camera.columns, origin, paths.direction, paths.n, kept, paths.route)


def trace_sub_rays(scene: Scene, world: OpticalWorld, *, object_shift_mm: Vector = (0.0, 0.0, 0.0)) -> SubRays:
    """Trace ``supersampling`` by ``supersampling`` evenly placed rays in each pixel.

    An object that was shifted is traced in its own frame, which is that of ``world``; there the camera has moved the other way.
    """
    shift = np.array(object_shift_mm)
    camera = scene.camera
    fold = camera.supersampling
    fine_rows, fine_columns = camera.rows * fold, camera.columns * fold
    count = fine_rows * fine_columns
    out = SubRays(
        fine_rows,
        fine_columns,
        np.empty((count, 3)),
        np.empty((count, 3)),
        np.empty(count),
        np.empty(count, np.float32),
        np.empty(count, np.int64),
    )

    def fill(start: int) -> None:
        number = np.arange(start, min(start + CHUNK_RAYS, count))
        part = slice(number[0], number[-1] + 1)
        row, column = np.divmod(number, fine_columns)
        direction = look(camera, (column + 0.5) / fold - 0.5, (row + 0.5) / fold - 0.5)
        paths = trace(world, np.broadcast_to(np.array(camera.position_mm) - shift, direction.shape), direction)
        out.origin[part], out.direction[part], out.n[part] = paths.origin + shift, paths.direction, paths.n
        kept = paths.transmission if scene.fresnel else np.ones(len(number))
        out.transmission[part] = np.where(paths.trapped, 0.0, kept)
        out.route[part] = paths.route

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(fill, range(0, count, CHUNK_RAYS)))
    return out


def meet_display(
    scene: Scene,
    stage_position_mm: float,
    origin: Float64[np.ndarray, "rays 3"],
    direction: Float64[np.ndarray, "rays 3"],
    n: Float64[np.ndarray, " rays"],
) -> ScreenHits:
    """Follow last pieces to the display at a stage position; coordinates are in **device pixels**, not mm."""
    panel = scene.display
    glass = panel.cover_glass
    hits = hit_screen(
        scene.display_pose_at(stage_position_mm),
        origin,
        direction,
        n,
        glass_thickness_mm=glass.thickness_mm if glass else 0.0,
        glass_n=glass.n if glass else 1.0,
    )
    column = hits.x_mm / panel.pitch_mm + panel.columns / 2 - 0.5
    row = hits.y_mm / panel.pitch_mm + panel.rows / 2 - 0.5
    return ScreenHits(column, row, hits.transmission if scene.fresnel else (hits.transmission > 0).astype(np.float64))


def screen_map(scene: Scene, rays: SubRays, stage_position_mm: float) -> ScreenMap:
    """Return where the sub-rays meet the display at a stage position."""
    shape = (rays.fine_rows, rays.fine_columns)
    hits = meet_display(scene, stage_position_mm, rays.origin, rays.direction, rays.n)
    lost = (rays.transmission == 0) | ~(hits.transmission > 0)
    column = np.where(lost, np.nan, hits.x_mm).reshape(shape)
    row = np.where(lost, np.nan, hits.y_mm).reshape(shape)
    kept = np.where(lost, 0.0, rays.transmission * hits.transmission).astype(np.float32).reshape(shape)
    return ScreenMap(column, row, kept, rays.route.reshape(shape))


def on_panel(scene: Scene, column_px: np.ndarray, row_px: np.ndarray) -> Bool[np.ndarray, "..."]:
    """Tell which places lie on the panel's pixels."""
    with np.errstate(invalid="ignore"):
        return (
            (column_px >= -0.5)
            & (column_px < scene.display.columns - 0.5)
            & (row_px >= -0.5)
            & (row_px < scene.display.rows - 0.5)
        )
