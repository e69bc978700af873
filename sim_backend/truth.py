"""What a reconstruction should find: the true last exit point and normal behind the centre of each pixel."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from sim_backend.display_bubbles import through_display_bubbles
from sim_backend.light_paths import SubRays, last_pieces, meet_display, on_panel, pixel_centre_paths
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
    RE_ENTERS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """``point_mm`` and ``normal`` [rows, columns, 3] in the scene's frame, NaN where ``status`` is not 0.

    The normal has length 1 and points out of the object, into the liquid. Status: 0 judged (the path through the
    object reaches the display in all four sets), 1 misses the object, 2 lost inside (totally reflected for good, leaves
    above the liquid or away from the display, or leaves elsewhere when wet), 3 misses the panel in some set, 4 leaves the object
    and enters it again, so that it leaves elsewhere when wet: no one point is its first.

    Where filling the tank moved the object or left bubbles, points, normals and status are those of the object where it stood
    dry; ``place_px`` is what is seen.
    """

    point_mm: Float64[np.ndarray, "rows columns 3"]
    normal: Float64[np.ndarray, "rows columns 3"]
    status: UInt8[np.ndarray, "rows columns"]
    place_px: Mapping[str, Float64[np.ndarray, "rows columns 2"]]


def compute_truth(scene: Scene) -> Truth:
    """Trace the centre of each pixel, dry and wet (or with and without a thin object), to both display positions."""
    ideal = scene.undisturbed()
    through = pixel_centre_paths(ideal, ideal.world(wet=False))
    liquid = scene.method == "liquid"
    other_world = ideal.world(wet=True) if liquid else ideal.world(wet=False, object_present=False)
    other = pixel_centre_paths(ideal, other_world)
    away = scene.display_pose_at(0.0).away()
    lost = through.trapped | other.trapped | (through.direction @ away <= 0) | (other.direction @ away <= 0)
    re_enters = np.zeros(len(lost), bool)
    if liquid:
        elsewhere = _leaves_elsewhere(scene, through, other)
        re_enters = elsewhere & ~lost & ((through.exits > 1) | (other.exits > 1))
        lost |= elsewhere
    shape = (scene.camera.rows, scene.camera.columns)
    other_name = "liquid" if liquid else "without"
    first_name = "air" if liquid else "with"
    pieces = {first_name: last_pieces(ideal, through), other_name: last_pieces(ideal, other)}
    place_px = _places(ideal, pieces)
    lit = np.logical_and.reduce([np.isfinite(place).all(axis=1) for place in place_px.values()])
    if scene.when_filled is not None:
        shift_mm = scene.object_shift_mm(wet=True)
        filled = pixel_centre_paths(scene, scene.world(wet=True), object_shift_mm=shift_mm)
        place_px |= _places(scene, {other_name: last_pieces(scene, filled, object_shift_mm=shift_mm)})
    touches = through.touched_object() | through.trapped
    status = np.select(
        [~touches, re_enters, lost, ~lit],
        [TruthStatus.MISSES_OBJECT, TruthStatus.RE_ENTERS, TruthStatus.LOST_INSIDE, TruthStatus.OFF_PANEL],
        TruthStatus.JUDGED,
    ).astype(np.uint8)
    judged = (status == TruthStatus.JUDGED)[:, None]
    return Truth(
        np.where(judged, through.exit_point, np.nan).reshape(*shape, 3),
        np.where(judged, through.exit_normal, np.nan).reshape(*shape, 3),
        status.reshape(shape),
        {name: place.reshape(*shape, 2) for name, place in place_px.items()},
    )


def _places(scene: Scene, pieces: Mapping[str, SubRays]) -> dict[str, Float64[np.ndarray, "rays 2"]]:
    """Return by the name of a set which device pixel each path ends on; NaN where it ends on none."""
    place_px = {}
    for condition, dry_or_wet in pieces.items():
        for position, stage_mm in enumerate(scene.stage_positions_mm):
            last = through_display_bubbles(scene, dry_or_wet, stage_mm)
            hits = meet_display(scene, stage_mm, last.origin, last.direction, last.n)
            seen = on_panel(scene, hits.x_mm, hits.y_mm) & (last.transmission > 0)
            place = np.stack([hits.x_mm, hits.y_mm], axis=1)
            place_px[f"pos{position}_{condition}"] = np.where(seen[:, None], place, np.nan)
    return place_px


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
