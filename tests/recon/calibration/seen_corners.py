"""Where the simulator's optics show points of the display: the independent truth of the calibration's tests."""

from collections.abc import Callable, Sequence

import numpy as np

from recon.calibration.board import Board
from recon.calibration.detection import BoardView
from recon.calibration.sight_line import PanelPose
from sim_backend.light_paths import look, meet_display
from sim_backend.optics.pinhole import distort
from sim_backend.optics.tracer import trace
from sim_backend.scene import Scene, load_scene

# Newton's method on a smooth map doubles the digits each time.
ROUNDS = 6
NUDGE_PX = 0.01


def rotation(*degrees: float) -> np.ndarray:
    """Return the turn about x, then y, then z, written out."""
    a, b, c = np.radians(degrees)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def lab_scene(*, camera_turn_deg: Sequence[float] = (2.0, -3.0, 1.0), glass_mm: float | None = None) -> Scene:
    """Return the paper's rig: 24 mm lens on a 3888 px camera, 420 mm over the object, a 9.7-inch tablet that leans a little.

    Focal length: 24 mm over 22.2 mm / 3888 px.
    """
    base = load_scene("hemisphere")
    turn, lean = rotation(*camera_turn_deg), rotation(0.6, -0.4, 0.8)
    camera = base.camera.model_copy(
        update={
            "columns": 3888,
            "rows": 2592,
            "focal_x_px": 4203.0,
            "focal_y_px": 4205.0,
            "centre_x_px": 1950.3,
            "centre_y_px": 1287.9,
            "distortion": (-0.12, 0.09, 4e-4, -3e-4, -0.02),
            "position_mm": (3.0, -5.0, -420.0),
            "x_axis": tuple(turn[:, 0]),
            "y_axis": tuple(turn[:, 1]),
        }
    )
    panel = {
        "columns": 2048,
        "rows": 1536,
        "pitch_mm": 0.0962,
        "x_axis": tuple(lean[:, 0]),
        "y_axis": tuple(lean[:, 1]),
        "stage_direction": tuple(rotation(0.2, 0.3, 0.0)[:, 2]),
        "cover_glass": {"thickness_mm": glass_mm, "n": 1.52} if glass_mm else None,
    }
    return base.model_validate(
        base.model_dump() | {"camera": camera.model_dump(), "display": base.display.model_dump() | panel}
    )


def true_lens(scene: Scene) -> np.ndarray:
    """Return the nine numbers of the scene's lens."""
    camera = scene.camera
    return np.array(
        [
            camera.focal_x_px,
            camera.focal_y_px,
            camera.centre_x_px,
            camera.centre_y_px,
            *(*camera.distortion, *[0.0] * 5)[:5],
        ]
    )


def true_pose(scene: Scene, stage_mm: float) -> PanelPose:
    """Return where the panel stands at a stage position, in the camera's frame."""
    pose = scene.display_pose_at(stage_mm)
    camera_from_world = scene.camera.world_from_camera().T
    axes = np.column_stack([pose.x_axis, pose.y_axis, pose.away()])
    return PanelPose(
        camera_from_world @ axes, camera_from_world @ (pose.centre_mm - np.array(scene.camera.position_mm))
    )


def slipped_scene(scene: Scene, stage_mm: float, moved: np.ndarray) -> Scene:
    """Return the scene with its panel moved, at one stage position: small turns about its axes (rad), shifts along them (mm)."""
    pose = scene.display_pose_at(stage_mm)
    axes = np.column_stack([pose.x_axis, pose.y_axis, pose.away()])
    turned = axes @ rotation(*np.degrees(moved[:3]))
    centre = pose.centre_mm + axes @ moved[3:] - stage_mm * np.array(scene.display.stage_direction)
    changes = {"centre_mm": tuple(centre), "x_axis": tuple(turned[:, 0]), "y_axis": tuple(turned[:, 1])}
    return scene.model_copy(update={"display": scene.display.model_copy(update=changes)})


def seen_places(scene: Scene, screen_mm: np.ndarray, stage_mm: float, *, wet: bool = False) -> np.ndarray:
    """Return where the camera sees points of the panel beside the object, by inverting the simulator's own ray tracing."""
    pose = true_pose(scene, stage_mm)
    place = project(scene, screen_mm @ pose.rotation[:, :2].T + pose.centre_mm)
    world = scene.world(wet=wet, object_present=False)

    def on_screen(places: np.ndarray) -> np.ndarray:
        direction = look(scene.camera, places[:, 0], places[:, 1])
        origin = np.broadcast_to(np.array(scene.camera.position_mm), direction.shape)
        paths = trace(world, origin, direction)
        hits = meet_display(scene, stage_mm, paths.origin, paths.direction, paths.n)
        panel = scene.display
        size = np.array([panel.columns, panel.rows])
        return (np.column_stack([hits.x_mm, hits.y_mm]) + 0.5 - size / 2) * panel.pitch_mm

    return newton(lambda places: on_screen(places) - screen_mm, place)


def seen_points(scene: Scene, point_mm: np.ndarray, *, wet: bool = False) -> np.ndarray:
    """Return where the camera sees any points in its frame, beside the object and without cover glass before them."""
    camera = scene.camera
    in_world = point_mm @ camera.world_from_camera().T + np.array(camera.position_mm)
    world = scene.world(wet=wet, object_present=False)

    def miss_mm(places: np.ndarray) -> np.ndarray:
        direction = look(camera, places[:, 0], places[:, 1])
        paths = trace(world, np.broadcast_to(np.array(camera.position_mm), direction.shape), direction)
        along_mm = (in_world[:, 2] - paths.origin[:, 2]) / paths.direction[:, 2]
        return (paths.origin + along_mm[:, None] * paths.direction - in_world)[:, :2]

    return newton(miss_mm, project(scene, point_mm))


def newton(miss: Callable[[np.ndarray], np.ndarray], place: np.ndarray) -> np.ndarray:
    """Return the places in the photo at which two misses are nought."""
    for _ in range(ROUNDS):
        here = miss(place)
        slope = np.stack([(miss(place + nudge) - here) / NUDGE_PX for nudge in NUDGE_PX * np.eye(2)], axis=2)
        place = place - np.linalg.solve(slope, here[:, :, None])[:, :, 0]
    return place


def project(scene: Scene, point_mm: np.ndarray) -> np.ndarray:
    """Return where points in the camera's frame are seen in air: a pinhole with the simulator's own lens model."""
    camera = scene.camera
    x, y = distort(point_mm[:, 0] / point_mm[:, 2], point_mm[:, 1] / point_mm[:, 2], camera.distortion)
    return np.column_stack([camera.focal_x_px * x + camera.centre_x_px, camera.focal_y_px * y + camera.centre_y_px])


def hand_held_views(
    scene: Scene, board: Board, *, count: int, rng: np.random.Generator, sd_px: float
) -> list[BoardView]:
    """Return noisy views of a board held all over the photo, tilted by up to 40°."""
    views = []
    corner_mm = board.corner_mm()
    corner_mm = corner_mm - corner_mm.mean(axis=0)
    camera = scene.camera
    number = np.arange(len(corner_mm))
    while len(views) < count:
        tilt = rng.uniform(-40, 40, 2)
        pose = rotation(*tilt, rng.uniform(-180, 180))
        depth_mm = rng.uniform(330, 520)
        share = rng.uniform(-0.4, 0.4, 2)
        centre = depth_mm * np.array([share[0] * camera.columns / 4203, share[1] * camera.rows / 4203, 1.0])
        place = project(scene, corner_mm @ pose[:, :2].T + centre)
        inside = ((place > 5) & (place < [camera.columns - 6, camera.rows - 6])).all(axis=1)
        if np.count_nonzero(inside) < min(20, len(corner_mm) // 2):
            continue
        noisy = place[inside] + rng.normal(0, sd_px, (np.count_nonzero(inside), 2))
        views.append(BoardView(number[inside], noisy, corner_mm[inside], "either", f"view{len(views)}"))
    return views


def panel_view(
    scene: Scene,
    corner_mm: np.ndarray,
    stage_mm: float,
    *,
    rng: np.random.Generator,
    sd_px: float,
    wet: bool = False,
    exact: np.ndarray | None = None,
) -> BoardView:
    """Return a noisy view of the board on the panel; ``exact`` places save the tracing where they are known."""
    place = seen_places(scene, corner_mm, stage_mm, wet=wet) if exact is None else exact
    noisy = place + rng.normal(0, sd_px, place.shape)
    return BoardView(np.arange(len(place)), noisy, corner_mm, "either", "panel")
