"""What a reconstruction should find: the true last exit point and normal behind the centre of each pixel."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from sim_backend.light_paths import meet_display, on_panel, pixel_centre_paths
from sim_backend.optics.tracer import Paths
from sim_backend.scene import Scene

# Wet and dry paths through the same pixel leave at the same point to rounding, or they are different paths.
SAME_POINT_MM = 1e-6


class TruthStatus(IntEnum):
    """Why a pixel has a true point, or has none."""

    JUDGED = 0
    MISSES_OBJECT = 1
    LOST_INSIDE = 2
    OFF_PANEL = 3


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """``point_mm`` and ``normal`` [rows, columns, 3] in the scene's frame, NaN where ``status`` is not 0.

    The normal has length 1 and points out of the object, into the liquid. Status: 0 judged (the path through the
    object reaches the display in all four sets), 1 misses the object, 2 lost inside (totally reflected for good, leaves
    above the liquid or away from the display, or leaves elsewhere when wet), 3 misses the panel in some set.
    """

    point_mm: Float64[np.ndarray, "rows columns 3"]
    normal: Float64[np.ndarray, "rows columns 3"]
    status: UInt8[np.ndarray, "rows columns"]
    place_px: Mapping[str, Float64[np.ndarray, "rows columns 2"]]


def compute_truth(scene: Scene) -> Truth:
    """Trace the centre of each pixel, dry and wet (or with and without a thin object), to both display positions."""
    through = pixel_centre_paths(scene, scene.world(wet=False))
    liquid = scene.method == "liquid"
    other_world = scene.world(wet=True) if liquid else scene.world(wet=False, object_present=False)
    other = pixel_centre_paths(scene, other_world)
    conditions = {"air": through, "liquid": other} if liquid else {"with": through, "without": other}
    found = [through.trapped, other.trapped]
    away = scene.display_pose_at(0.0).away()
    lost = np.logical_or.reduce(found) | (through.direction @ away <= 0) | (other.direction @ away <= 0)
    if liquid:
        lost |= _leaves_elsewhere(scene, through, other)
    shape = (scene.camera.rows, scene.camera.columns)
    seen = np.ones(len(lost), bool)
    place_px = {}
    for condition, paths in conditions.items():
        for position, stage_mm in enumerate(scene.stage_positions_mm):
            hits = meet_display(scene, stage_mm, paths.origin, paths.direction, paths.n)
            lit = on_panel(scene, hits.x_mm, hits.y_mm)
            place = np.stack([hits.x_mm, hits.y_mm], axis=1)
            place_px[f"pos{position}_{condition}"] = np.where((lit & ~paths.trapped)[:, None], place, np.nan).reshape(
                *shape, 2
            )
            seen &= lit
    touches = through.touched_object() | through.trapped
    status = np.select(
        [~touches, lost, ~seen],
        [TruthStatus.MISSES_OBJECT, TruthStatus.LOST_INSIDE, TruthStatus.OFF_PANEL],
        TruthStatus.JUDGED,
    ).astype(np.uint8)
    judged = (status == TruthStatus.JUDGED)[:, None]
    return Truth(
        np.where(judged, through.exit_point, np.nan).reshape(*shape, 3),
        np.where(judged, through.exit_normal, np.nan).reshape(*shape, 3),
        status.reshape(shape),
        place_px,
    )


def _leaves_elsewhere(scene: Scene, dry: Paths, wet: Paths) -> Bool[np.ndarray, " rays"]:
    """Tell which paths leave the object above the liquid, or at another point once there is liquid."""
    level = scene.liquid_level_mm if scene.liquid_level_mm is not None else -np.inf
    with np.errstate(invalid="ignore"):
        moved = ~(np.linalg.norm(dry.exit_point - wet.exit_point, axis=1) < SAME_POINT_MM)
        above = ~(dry.exit_point[:, 2] > level)
    return moved | above


def save_truth(truth: Truth, path: Path) -> None:
    """Write ``truth.npz`` with ``point_mm``, ``normal``, ``status``, and ``place_px_SET`` for each set."""
    arrays: dict[str, Any] = {"point_mm": truth.point_mm, "normal": truth.normal, "status": truth.status}
    arrays |= {f"place_px_{name}": place for name, place in truth.place_px.items()}
    np.savez_compressed(path, **arrays)
