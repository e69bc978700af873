"""A display that slipped between dry and wet: what it costs in entry points, and what measuring it again brings back.

The pixels' places on the display, the photos of the board and the truth all come from the simulator's optics.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from seen_corners import (
    hand_held_views,
    lab_scene,
    panel_view,
    slipped_scene,
)

from recon.calibration.board import Board, board_for_display
from recon.calibration.bundle import BundleResult
from recon.calibration.constraints import lens_known, travel_known
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS, Travel, display_poses, manifest_pose
from recon.calibration.fep_error import Geometry, entry_points_of
from recon.calibration.intrinsics import calibrate_lens
from recon.calibration.sight_line import PanelPose
from recon.calibration.wet_pose import slips, wet_poses
from recon.patterns.sweep_frames import screen_mm
from recon.sessions.manifest import DisplayPanel
from sim_backend.photography import Photographer
from sim_backend.scene import Scene

SLIP_MM = 0.3
# As the simulated photos of test_simulated_photo show.
CORNER_SD_PX = 0.05
PHOTOS = 4  # of the board in each pose
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
    small = [one.model_copy(update={"camera": one.camera.model_copy(update={"supersampling": 1})}) for one in small]
    photographer, after = (Photographer(one) for one in small)
    truth = photographer.truth()
    judged = truth.status == 0
    places: dict[str, np.ndarray] = {}
    for position, stage_mm in enumerate(scene.stage_positions_mm):
        for condition, wet in (("air", False), ("liquid", True)):
            source = after if wet and position == 1 else photographer
            places[f"pos{position}_{condition}"] = source.pixel_coordinates(stage_position_mm=stage_mm, wet=wet)
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


def beside_the_object(corner_mm: np.ndarray) -> np.ndarray:
    """Return the corners that are seen past the object from every part of the rig, with a margin."""
    return corner_mm[np.linalg.norm(corner_mm, axis=1) > 1.6 * OBJECT_RADIUS_MM]


def measured(
    scene: Scene, slipped: Scene, *, rng: np.random.Generator, photos: int
) -> tuple[BundleResult, BundleResult]:
    """Calibrate lens and dry poses, then measure again under liquid: position 1 as it slipped; so many photos a pose."""
    lens_views = hand_held_views(scene, Board(10, 8, 15.0), count=15, rng=rng, sd_px=CORNER_SD_PX)
    lens = calibrate_lens(lens_views, columns=3888, rows=2592)
    all_mm = board_for_display(PANEL).board.corner_mm()
    seen_mm = beside_the_object(all_mm)
    stage_mm = scene.stage_positions_mm
    dry: dict[int, list[BoardView]] = {
        p: [panel_view(scene, all_mm, stage_mm[p], rng=rng, sd_px=CORNER_SD_PX) for _ in range(photos)] for p in (0, 1)
    }
    wet = {
        p: [
            panel_view((scene, slipped)[p], seen_mm, stage_mm[p], rng=rng, sd_px=CORNER_SD_PX, wet=True)
            for _ in range(photos)
        ]
        for p in (0, 1)
    }
    travel = Travel(40.0, 0.02)
    first = display_poses(dry, lens=lens.lens, lens_covariance=lens.covariance, travel=travel)
    known = [
        lens_known(lens.lens, lens.covariance),
        travel_known(*AIR_PANELS, travel_mm=travel.distance_mm, sd_mm=travel.sd_mm),
    ]
    assert scene.n_liquid is not None
    return first, wet_poses(first, dry, wet, n_liquid=scene.n_liquid, known=known)


@pytest.mark.slow
def test_a_slip_of_three_tenths_is_found_and_its_harm_undone() -> None:
    scene = lab_scene()
    slipped = slipped_scene(scene, scene.stage_positions_mm[1], np.array([0, 0, 0, 0.8 * SLIP_MM, 0.6 * SLIP_MM, 0]))
    rng = np.random.default_rng(8)
    first, second = measured(scene, slipped, rng=rng, photos=PHOTOS)
    before, after = slips(second)
    assert not before.found()
    assert after.found()
    sd_mm = np.sqrt(np.diag(after.covariance)[3:5])
    assert (np.abs(after.moved[3:5] - [0.8 * SLIP_MM, 0.6 * SLIP_MM]) < 4 * sd_mm).all()
    assert "fasten it" in after.sentence()

    dry_panels = {name: first.state.panels[name] for name in AIR_PANELS}
    geometry, point_mm, normal = pixels_of(scene, scene, rng=np.random.default_rng(9))
    undisturbed = errors(geometry, dry_panels, point_mm, normal)
    geometry, point_mm, normal = pixels_of(scene, slipped, rng=np.random.default_rng(9))
    uncorrected = errors(geometry, dry_panels, point_mm, normal)
    corrected = errors(geometry, second.state.panels, point_mm, normal)
    assert corrected.point_mm < 1.2 * undisturbed.point_mm
    assert corrected.normal_deg < 1.2 * undisturbed.normal_deg
    assert uncorrected.normal_deg > 3 * undisturbed.normal_deg


def test_a_measured_pose_keeps_its_axes_in_the_manifest() -> None:
    pose = PanelPose(np.eye(3)[:, [1, 0, 2]] * [1, 1, -1], np.array([1.0, 2.0, 3.0]))
    written = manifest_pose(pose)
    assert np.allclose(written.world_from_screen()[:3, :3], pose.rotation)
    assert written.centre_mm == (1.0, 2.0, 3.0)
