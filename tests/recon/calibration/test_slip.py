"""A display that slipped between dry and wet: what it costs in entry points, and what measuring it again brings back.

The pixels' places on the display, the photos of the board and the truth all come from the simulator's optics.
"""

import numpy as np
import pytest
from seen_corners import (
    hand_held_views,
    lab_scene,
    panel_view,
    slipped_scene,
)
from seen_object import OBJECT_RADIUS_MM, PANEL, errors, pixels_of

from recon.calibration.board import Board, board_for_display
from recon.calibration.bundle import BundleResult
from recon.calibration.constraints import lens_known, travel_known
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS, Travel, display_poses, manifest_pose
from recon.calibration.intrinsics import calibrate_lens
from recon.calibration.sight_line import PanelPose
from recon.calibration.wet_pose import slips, wet_poses
from sim_backend.scene import Scene

SLIP_MM = 0.3
# As the simulated photos of test_simulated_photo show.
CORNER_SD_PX = 0.05
PHOTOS = 4  # of the board in each pose


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
