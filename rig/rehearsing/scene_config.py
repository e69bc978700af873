"""From a simulated scene to the configuration of the rig that photographs it.

What a scene does not say, because light does not care, is said here once: how fast the simulated stage, pump and camera are.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from pydantic import ValidationError

from recon.bad_value import first_fault
from recon.sessions.manifest import (
    CameraBody,
    CoverGlass,
    DisplayPanel,
    Intrinsics,
    Liquid,
    Pose,
    ScannedObject,
)
from rig.config import RigConfig, parse_config
from rig.errors import ConfigError
from sim_backend.light_paths import pixel_centre_paths
from sim_backend.marks import marks_seen_px, with_marks
from sim_backend.optics.screen import ScreenPose
from sim_backend.scene import Scene, SceneError, load_scene

# The simulated rig: an ordinary belt stage, a peristaltic pump, and a camera read out over USB.
STAGE_VELOCITY_MM_PER_S = 5.0
STAGE_MARGIN_MM = 10.0
PUMP_RATE_ML_PER_MIN = 1200.0
RESERVOIR_SURPLUS = 1.05
# The line of a Gray code with line shift whose period is 16 device pixels.
STRIPE_OF_CODE = {"width_px": 4.0, "step_px": 1.0}
TIMING = {
    "photo_s": 2.0,
    "settle_s": 0.1,
    "still_after_move_s": 2.0,
    "still_after_fill_s": 60.0,
}
# Measured: 54 MB for 520 noisy photos of 1024 × 1024 that are mostly dark (grey JPEG, quality 95).
PHOTO_BYTES_PER_PIXEL = 0.1
# The object's outline is traced in a photo of this width: an edge that is a pixel or two off belongs to no part anyway.
OUTLINE_COLUMNS = 160
# How well the simulated stage's way is said to be known.
TRAVEL_SD_MM = 0.02
# Boards: the printed one's share of the photo, and the side of a square in the photo from which its marker is read for certain.
PRINTED_SHARE = 0.6
SQUARE_SEEN_PX = 36.0


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """What may be changed about a scene and its capture from the command line; None keeps the scene's own value."""

    profile: Literal["hard", "raised_cosine"] | None = None
    width_px: float | None = None
    step_px: float | None = None
    order: Literal["one_fill", "paper"] | None = None
    camera_columns: int | None = None
    display_columns: int | None = None
    seed: int | None = None
    scan: bool = False
    live: bool = False
    watch: bool = False
    auto_exposure: bool = False
    code: Literal["gray_line", "phase_shift"] | None = None
    board: bool = False
    visual_rays: Literal["photographed", "camera"] | None = None


def open_scene(name_or_path: str, options: SceneOptions) -> Scene:
    """Return the scene with its size and seed changed as the options say."""
    try:
        scene = load_scene(name_or_path).resized(
            camera_columns=options.camera_columns, display_columns=options.display_columns
        )
    except (SceneError, OSError) as error:
        if isinstance(error.__cause__, ValidationError):
            raise ConfigError(f"scene {name_or_path!r}: {first_fault(error.__cause__, whole='as a whole')}") from None
        raise ConfigError(str(error)) from None
    except UnicodeDecodeError:
        raise ConfigError(
            f"scene {name_or_path!r} is not a text file; give a name from `rig scenes`, or a TOML file"
        ) from None
    if options.watch and scene.marks is None:
        scene = with_marks(scene)
    return scene if options.seed is None else scene.model_copy(update={"seed": options.seed})


def config_of_scene(scene: Scene, options: SceneOptions) -> RigConfig:
    """Return the configuration of the simulated rig in front of ``scene``; its sweeps cover the whole display."""
    stripe = scene.stripe if options.code is None else scene.stripe.model_copy(update=STRIPE_OF_CODE)
    low_mm, high_mm = min(scene.stage_positions_mm), max(scene.stage_positions_mm)
    pixels = scene.camera.columns * scene.camera.rows
    return parse_config(
        {
            "name": scene.name,
            "method": scene.method,
            "length_unit": scene.length_unit,
            "object": ScannedObject(name=scene.name, n=scene.n_object, note=scene.note),
            "n_air": scene.n_air,
            "liquid": Liquid(name=scene.liquid, n=scene.n_liquid) if _is_wet(scene) and scene.n_liquid else None,
            "display": _panel(scene),
            "display_poses": tuple(_pose(scene.display_pose_at(place_mm)) for place_mm in scene.stage_positions_mm),
            "camera": _camera(scene),
            "capture": {
                "order": options.order or "one_fill",
                "stripe": {
                    "profile": options.profile or stripe.profile,
                    "width_px": stripe.width_px if options.width_px is None else options.width_px,
                    "step_px": stripe.step_px if options.step_px is None else options.step_px,
                },
                "swept": {
                    "first_column_px": 0,
                    "last_column_px": scene.display.columns - 1,
                    "first_row_px": 0,
                    "last_row_px": scene.display.rows - 1,
                },
                "code": {"kind": options.code} if options.code else None,
                "scan": {} if options.scan else None,
                "auto_exposure": {"setting": "shutter"} if options.auto_exposure else None,
                "board": {} if options.board else None,
                "visual_rays": {"source": options.visual_rays} if options.visual_rays else None,
            },
            "live": _live(scene) if options.live else None,
            "watch": watch_of_scene(scene) if options.watch else None,
            "tank": _tank(scene) if _is_wet(scene) else None,
            "stage": {
                "position_0_mm": scene.stage_positions_mm[0],
                "position_1_mm": scene.stage_positions_mm[1],
                "travel_mm": (min(0.0, low_mm - STAGE_MARGIN_MM), high_mm + STAGE_MARGIN_MM),
                "velocity_mm_per_s": STAGE_VELOCITY_MM_PER_S,
            },
            "calibrate": _calibrate(scene),
            "timing": {**TIMING, "photo_mb": pixels * PHOTO_BYTES_PER_PIXEL / 1e6},
        },
        source=f"scene {scene.name}",
    )


def _live(scene: Scene) -> dict[str, object]:
    """Return the section [live]; the object's wet side is taken where the liquid ends, which is the farther end of it."""
    if scene.liquid_level_mm is None:
        return {}
    nearer_mm = min(abs(place_mm - scene.liquid_level_mm) for place_mm in scene.stage_positions_mm)
    return {"object_distance_mm": nearer_mm}


def _calibrate(scene: Scene) -> dict[str, object]:
    """Return boards whose squares are large enough to be read: the printed one takes 0.6 of the photo's width at the display."""
    camera, panel = scene.camera, scene.display
    away_mm = [
        float(np.linalg.norm(scene.display_pose_at(place_mm).centre_mm - np.array(camera.position_mm)))
        for place_mm in scene.stage_positions_mm
    ]
    # The farthest pose of a hand shows the board on 0.45 of the photo's width.
    across = int(np.clip(0.45 * camera.columns / SQUARE_SEEN_PX, 5, 9))
    squares = (across, max(4, round(across * 2 / 3)))
    # Squares on the display are whole tens of device pixels, as their markers have six tenths of them.
    device_px_seen = SQUARE_SEEN_PX * max(away_mm) / (camera.focal_x_px * panel.pitch_mm)
    along = max(panel.columns, panel.rows) // (10 * int(np.ceil(device_px_seen / 10)))
    return {
        "squares": squares,
        "square_mm": float(np.round(PRINTED_SHARE * camera.columns * min(away_mm) / camera.focal_x_px / squares[0], 3)),
        "squares_along": int(np.clip(along, 4, 16)),
        "travel_sd_mm": TRAVEL_SD_MM,
    }


def watch_of_scene(scene: Scene) -> dict[str, object]:
    """Return the section [watch]: where the object and the marks are in the photos of ``scene``."""
    camera = scene.camera
    small = scene.resized(camera_columns=min(camera.columns, OUTLINE_COLUMNS))
    paths = pixel_centre_paths(small, small.world(wet=False))
    row, column = np.nonzero((paths.touched_object() | paths.trapped).reshape(small.camera.rows, small.camera.columns))
    scale = camera.columns / small.camera.columns
    outline: list[tuple[float, float]] = []
    if row.size:
        corners = np.column_stack([column, row]).astype(np.float32)
        outline = [
            ((float(x) + 0.5) * scale - 0.5, (float(y) + 0.5) * scale - 0.5) for x, y in cv2.convexHull(corners)[:, 0]
        ]
    return {"object_px": outline if len(outline) > 2 else [], "marks_px": marks_seen_px(scene)}


def _is_wet(scene: Scene) -> bool:
    return scene.method == "liquid"


def _tank(scene: Scene) -> dict[str, object]:
    return {
        "free_volume_ml": scene.tank.free_volume_ml,
        "fill_ml": scene.tank.fill_ml,
        "reservoir_ml": min(scene.tank.free_volume_ml, RESERVOIR_SURPLUS * scene.tank.fill_ml),
        "has_pump": True,
        "pump_rate_ml_per_min": PUMP_RATE_ML_PER_MIN,
        "drain_at_end": True,
    }


def _panel(scene: Scene) -> DisplayPanel:
    glass = scene.display.cover_glass
    return DisplayPanel(
        columns=scene.display.columns,
        rows=scene.display.rows,
        pitch_mm=scene.display.pitch_mm,
        cover_glass=CoverGlass(thickness_mm=glass.thickness_mm, n=glass.n) if glass else None,
    )


def _camera(scene: Scene) -> CameraBody:
    camera = scene.camera
    return CameraBody(
        columns=camera.columns,
        rows=camera.rows,
        model="simulated camera",
        pose=Pose(centre_mm=camera.position_mm, x_axis=camera.x_axis, y_axis=camera.y_axis),
        intrinsics=Intrinsics(
            focal_x_px=camera.focal_x_px,
            focal_y_px=camera.focal_y_px,
            centre_x_px=camera.centre_x_px,
            centre_y_px=camera.centre_y_px,
            distortion=camera.distortion,
        ),
    )


def _pose(pose: ScreenPose) -> Pose:
    x, y, z = (float(value) for value in pose.centre_mm)
    return Pose(
        centre_mm=(x, y, z),
        x_axis=(float(pose.x_axis[0]), float(pose.x_axis[1]), float(pose.x_axis[2])),
        y_axis=(float(pose.y_axis[0]), float(pose.y_axis[1]), float(pose.y_axis[2])),
    )
