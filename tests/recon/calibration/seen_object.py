"""Pixels that see the glass hemisphere, by the simulator's optics, and how far entry points found from them are from truth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from recon.calibration.display_poses import AIR_PANELS
from recon.calibration.fep_error import Geometry, entry_points_of
from recon.calibration.sight_line import PanelPose
from recon.patterns.sweep_frames import screen_mm
from recon.sessions.manifest import DisplayPanel
from sim_backend.scene import Scene
from sim_backend.truth import compute_truth

CORRESPONDENCE_SD_PX = 0.1  # of the display, as in the figures of the method's sources of error
PANEL = DisplayPanel(columns=2048, rows=1536, pitch_mm=0.0962)
OBJECT_RADIUS_MM = 27.99


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Mean errors over the pixels that see the object in all four sets."""

    point_mm: float
    normal_deg: float


def pixels_of(
    scene: Scene, slipped: Scene, *, rng: np.random.Generator, sd_px: float = CORRESPONDENCE_SD_PX
) -> tuple[Geometry, np.ndarray, np.ndarray]:
    """Return noisy display places of the pixels that see the object, and the true points and normals in the camera's frame."""
    small = [one.resized(camera_columns=486) for one in (scene, slipped)]
    truth, after = (compute_truth(one) for one in small)
    judged = truth.status == 0
    places = {**truth.place_px, "pos1_liquid": after.place_px["pos1_liquid"]}
    for place in places.values():
        judged &= np.isfinite(place).all(axis=2)
    screen = {}
    for name, place in places.items():
        noisy = place[judged] + rng.normal(0, sd_px, (np.count_nonzero(judged), 2))
        screen[name] = np.column_stack([screen_mm(noisy[:, 0], "x", PANEL), screen_mm(noisy[:, 1], "y", PANEL)])
    camera_from_world = scene.camera.world_from_camera().T
    point_mm = (truth.point_mm[judged] - np.array(scene.camera.position_mm)) @ camera_from_world.T
    assert scene.n_liquid is not None
    return Geometry(screen, n_liquid=scene.n_liquid), point_mm, truth.normal[judged] @ camera_from_world.T


def errors(geometry: Geometry, panels: Mapping[str, PanelPose], point_mm: np.ndarray, normal: np.ndarray) -> Errors:
    """Return the mean errors over points whose paths cross at 1° at least, as the paper asks."""
    found_mm, found_normal = entry_points_of(geometry, panels)
    off_mm = np.linalg.norm(found_mm - point_mm, axis=1)
    off_deg = np.degrees(np.arccos(np.clip((found_normal * normal).sum(axis=1), -1, 1)))
    # Where light hits nearly upright the two paths hardly differ: the truth's own angle decides, alike for all.
    steep = np.abs((normal * _down(panels)).sum(axis=1)) < np.cos(np.radians(15.0))
    return Errors(float(off_mm[steep].mean()), float(off_deg[steep].mean()))


def _down(panels: Mapping[str, PanelPose]) -> np.ndarray:
    return panels[AIR_PANELS[0]].rotation[:, 2]


def shape_error_mm(found_mm: np.ndarray, true_mm: np.ndarray) -> float:
    """Return the rms distance after the best motion as a whole (Kabsch)."""
    a, b = true_mm - true_mm.mean(axis=0), found_mm - found_mm.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    return float(np.sqrt(((b - a @ (u @ vt)) ** 2).sum(axis=1).mean()))


def in_frame_of(panel: PanelPose, point_mm: np.ndarray) -> np.ndarray:
    """Return points of the camera's frame in that of a panel."""
    return (point_mm - panel.centre_mm) @ panel.rotation
