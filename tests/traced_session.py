"""Correspondences of a scene straight from the simulator's optics, without photos: those of a perfect stripe fit, plus noise.

The displays may have slipped, and the object moved, between air and liquid; the manifest knows nothing of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from recon.evaluation.truth import Truth
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.noise import NoiseModel
from sim_backend.light_paths import look, on_panel
from sim_backend.optics.screen import ScreenPose, hit_screen
from sim_backend.optics.tracer import Paths, trace
from sim_backend.scene import Scene
from sim_backend.truth import TruthStatus, compute_truth

Slip = tuple[float, float, float]
NO_SHIFT = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Mishap:
    """What went wrong: slips (x and y in mm, turn in rad) by set name, and how far the object moved when the tank was filled."""

    slips: Mapping[str, Slip] = field(default_factory=dict)
    object_shift_mm: tuple[float, float, float] = NO_SHIFT


@dataclass(frozen=True, slots=True, eq=False)
class TracedSession:
    """A manifest, its decoded sweeps, and the truth on the camera grid."""

    manifest: Manifest
    sweeps: dict[tuple[str, str], SweepResult]
    truth: Truth


NOTHING_WRONG = Mishap()


def traced_session(
    scene: Scene, *, noise_px: float, stated_sd_px: float | None = None, mishap: Mishap = NOTHING_WRONG, seed: int = 0
) -> TracedSession:
    """Trace the centre of every pixel in all four sets; ``noise_px`` is Gaussian, in device pixels."""
    sweeps = {}
    conditions = ("air", "liquid") if scene.method == "liquid" else ("without", "with")
    for condition in conditions:
        paths = _paths(scene, condition, mishap.object_shift_mm if condition == "liquid" else NO_SHIFT)
        for position in (0, 1):
            name = f"pos{position}_{condition}"
            places = _places(scene, position, paths, mishap.slips.get(name, NO_SHIFT))
            for axis, place in zip(("x", "y"), places, strict=True):
                sweeps[name, axis] = _sweep(place, noise_px if stated_sd_px is None else stated_sd_px)
    found = compute_truth(scene)
    lit = np.isin(found.status, (TruthStatus.JUDGED, TruthStatus.MISSES_OBJECT))
    truth = Truth(found.point_mm, found.normal, found.status == TruthStatus.JUDGED, lit)
    exact = TracedSession(Manifest.model_validate(manifest_fields(scene)), sweeps, truth)
    return with_noise(exact, noise_px=noise_px, stated_sd_px=stated_sd_px, seed=seed) if noise_px else exact


def with_noise(
    session: TracedSession, *, noise_px: float, stated_sd_px: float | None = None, seed: int = 0
) -> TracedSession:
    """Return a session with Gaussian noise on every correspondence, in device pixels, and the sd that it states."""
    rng = np.random.default_rng(seed)
    sd_px = noise_px if stated_sd_px is None else stated_sd_px
    sweeps = {
        key: _sweep(one.place_px + rng.normal(0.0, noise_px, one.place_px.shape), sd_px)
        for key, one in session.sweeps.items()
    }
    return replace(session, sweeps=sweeps)


def manifest_fields(scene: Scene) -> dict[str, Any]:
    """Return the manifest of a capture of the scene: what its maker believes."""
    panel, camera = scene.display, scene.camera
    pattern = {"profile": "raised_cosine", "width_px": 6.0, "first_px": 0.0, "step_px": 1.0, "count": 3}
    sweeps = [{"axis": axis, "pattern": pattern} for axis in ("x", "y")]
    conditions = ("air", "liquid") if scene.method == "liquid" else ("without", "with")
    poses = []
    for stage_mm in scene.stage_positions_mm:
        pose = scene.display_pose_at(stage_mm)
        poses.append(_pose(pose.centre_mm, pose.x_axis, pose.y_axis))
    fields: dict[str, Any] = {
        "schema_version": 1,
        "name": scene.name,
        "created": "2018-06-01T12:00:00Z",
        "method": scene.method,
        "object": {"name": scene.name, "n": scene.n_object},
        "n_air": scene.n_air,
        "length_unit": scene.length_unit,
        "display": {"columns": panel.columns, "rows": panel.rows, "pitch_mm": panel.pitch_mm},
        "display_poses": poses,
        "camera": {
            "columns": camera.columns,
            "rows": camera.rows,
            "pose": _pose(camera.position_mm, camera.x_axis, camera.y_axis),
            "intrinsics": {
                name: getattr(camera, name) for name in ("focal_x_px", "focal_y_px", "centre_x_px", "centre_y_px")
            },
        },
        "sets": [
            {"position": position, "condition": condition, "sweeps": sweeps}
            for condition in conditions
            for position in (0, 1)
        ],
    }
    if panel.cover_glass is not None:
        fields["display"]["cover_glass"] = panel.cover_glass.model_dump()
    if scene.method == "liquid":
        fields["liquid"] = {"name": scene.liquid, "n": scene.n_liquid}
    return fields


def _pose(centre: Any, x_axis: Any, y_axis: Any) -> dict[str, list[float]]:
    named = zip(("centre_mm", "x_axis", "y_axis"), (centre, x_axis, y_axis), strict=True)
    return {name: [float(number) for number in vector] for name, vector in named}


def _paths(scene: Scene, condition: str, shift_mm: tuple[float, float, float]) -> Paths:
    """Trace all pixels; an object that moved is traced in its own frame, where camera and liquid moved the other way."""
    row, column = np.indices((scene.camera.rows, scene.camera.columns)).reshape(2, -1).astype(np.float64)
    direction = look(scene.camera, column, row)
    shift = np.array(shift_mm)
    if shift[2] and scene.liquid_level_mm is not None:
        scene = scene.model_copy(update={"liquid_level_mm": scene.liquid_level_mm - shift[2]})
    origin = np.broadcast_to(np.array(scene.camera.position_mm) - shift, direction.shape)
    paths = trace(scene.world(wet=condition == "liquid", object_present=condition != "without"), origin, direction)
    return Paths(
        **{name: getattr(paths, name) for name in Paths.__slots__ if name != "origin"}, origin=paths.origin + shift
    )


def _places(scene: Scene, position: int, paths: Paths, slip: Slip) -> tuple[np.ndarray, np.ndarray]:
    """Return display columns and rows, NaN where the light comes from no place on the panel."""
    stands = scene.display_pose_at(scene.stage_positions_mm[position])
    cosine, sine = np.cos(slip[2]), np.sin(slip[2])
    pose = ScreenPose(
        stands.centre_mm + slip[0] * stands.x_axis + slip[1] * stands.y_axis,
        cosine * stands.x_axis + sine * stands.y_axis,
        cosine * stands.y_axis - sine * stands.x_axis,
    )
    glass = scene.display.cover_glass
    hits = hit_screen(
        pose,
        paths.origin,
        paths.direction,
        paths.n,
        glass_thickness_mm=glass.thickness_mm if glass else 0.0,
        glass_n=glass.n if glass else 1.0,
    )
    column = hits.x_mm / scene.display.pitch_mm + scene.display.columns / 2 - 0.5
    row = hits.y_mm / scene.display.pitch_mm + scene.display.rows / 2 - 0.5
    seen = on_panel(scene, column, row) & ~paths.trapped
    shape = (scene.camera.rows, scene.camera.columns)
    return np.where(seen, column, np.nan).reshape(shape), np.where(seen, row, np.nan).reshape(shape)


def _sweep(place_px: np.ndarray, sd_px: float) -> SweepResult:
    seen = np.isfinite(place_px)
    return SweepResult(
        place_px=place_px,
        sd_px=np.where(seen, np.float32(sd_px), np.float32(np.nan)),
        status=np.where(seen, np.uint8(PixelStatus.OK), np.uint8(PixelStatus.UNLIT)),
        noise=NoiseModel(1.0),
        misfit=1.0,
        photos=(),
        curves=(),
    )
