"""Fifty calibrations with noise, lens and poses known to the simulator alone: errors are as large as the covariance says.

Normalised errors must have unit variance: χ² of d numbers with their joint covariance has the mean d and, over n runs, the spread
√(2d/n).
"""

import numpy as np
import pytest
from seen_corners import (
    hand_held_views,
    lab_scene,
    panel_view,
    seen_places,
    seen_points,
    slipped_scene,
    true_lens,
    true_pose,
)

from recon.calibration.board import Board, board_for_display
from recon.calibration.constraints import lens_known, slip, travel_known
from recon.calibration.display_poses import AIR_PANELS, PitchKnowledge, Travel, display_poses
from recon.calibration.intrinsics import calibrate_lens
from recon.calibration.wet_pose import WET_PANELS, SlipKnowledge, wet_poses
from recon.sessions.manifest import DisplayPanel

RUNS = 50
SIGMA = 4.0  # of the spread that chance gives the mean square
CORNER_SD_PX = 0.1
TRAVEL_SD_MM = 0.02
PITCH_SHARE = 1.003  # the true pitch over the one that the maker says
BOARD = Board(7, 6, 25.0)
SHOWN = board_for_display(DisplayPanel(columns=2048, rows=1536, pitch_mm=0.0962), squares_along=6).board


def chi_square(error: np.ndarray, covariance: np.ndarray) -> float:
    scale = np.sqrt(np.diag(covariance))
    return float((error / scale) @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale))


def assert_of_unit_variance(squares: list[float], *, numbers: int) -> None:
    mean, spread = np.mean(squares) / numbers, np.sqrt(2 / (numbers * len(squares)))
    assert abs(mean - 1) < SIGMA * spread, f"mean square of the normalised errors {mean:.3f}, expected 1 ± {spread:.3f}"


@pytest.mark.slow
def test_lens_poses_and_pitch_err_as_their_covariance_says() -> None:
    scene = lab_scene()
    stage_mm, truth = scene.stage_positions_mm, true_lens(scene)
    corner_mm = SHOWN.corner_mm()
    exact = [seen_places(scene, corner_mm, place) for place in stage_mm]
    poses = [true_pose(scene, place) for place in stage_mm]
    travel_mm = float(np.linalg.norm(poses[1].centre_mm - poses[0].centre_mm))
    rng = np.random.default_rng(2018)
    lens_squares, pose_squares, pitch_squares, corner_sd = [], [], [], []
    for _ in range(RUNS):
        views = hand_held_views(scene, BOARD, count=9, rng=rng, sd_px=CORNER_SD_PX)
        estimate = calibrate_lens(views, columns=3888, rows=2592)
        lens_squares.append(chi_square(estimate.lens - truth, estimate.covariance))
        # What the maker says of the pitch is off: corners seem PITCH_SHARE nearer to the middle than they are.
        seen = {
            position: [
                panel_view(scene, corner_mm / PITCH_SHARE, place, rng=rng, sd_px=CORNER_SD_PX, exact=exact[position])
            ]
            for position, place in enumerate(stage_mm)
        }
        travel = Travel(travel_mm + rng.normal(0, TRAVEL_SD_MM), TRAVEL_SD_MM)
        found = display_poses(
            seen,
            lens=estimate.lens,
            lens_covariance=estimate.covariance,
            travel=travel,
            pitch=PitchKnowledge(sd_share=0.1),
        )
        errors = []
        for name, pose in zip(AIR_PANELS, poses, strict=True):
            error = slip(pose, found.state.panels[name])  # about the panel's axes; the covariance is about the camera's
            errors += [pose.rotation @ error[:3], pose.rotation @ error[3:]]
        pose_squares.append(chi_square(np.concatenate(errors), found.covariance_of(*AIR_PANELS)))
        pitch_squares.append(chi_square(np.array([found.state.scale - PITCH_SHARE]), found.covariance_of("scale")))
        corner_sd.append(found.corner_sd_px)
    assert_of_unit_variance(lens_squares, numbers=9)
    assert_of_unit_variance(pose_squares, numbers=12)
    assert_of_unit_variance(pitch_squares, numbers=1)
    corners = 2 * 2 * len(corner_mm)
    assert np.mean(corner_sd) == pytest.approx(CORNER_SD_PX, rel=SIGMA / np.sqrt(2 * corners * RUNS))


@pytest.mark.slow
def test_slips_under_liquid_err_as_their_covariance_says() -> None:
    scene = lab_scene()
    assert scene.n_liquid is not None
    stage_mm, truth = scene.stage_positions_mm, true_lens(scene)
    corner_mm = SHOWN.corner_mm()
    may_slip = SlipKnowledge(in_plane_mm=0.5, in_plane_rad=0.005, along_normal_mm=0.05, lean_rad=0.0005)
    dry_exact = [seen_places(scene, corner_mm, place) for place in stage_mm]
    lens_covariance = np.diag(np.array([1.0, 1.0, 1.0, 1.0, 1e-3, 7e-3, 6e-5, 7e-5, 2e-2]) ** 2)
    rng = np.random.default_rng(42)
    start = {
        p: [panel_view(scene, corner_mm, stage_mm[p], rng=rng, sd_px=CORNER_SD_PX, exact=dry_exact[p])] for p in (0, 1)
    }
    first = display_poses(start, lens=truth, lens_covariance=lens_covariance, travel=Travel(40.0, TRAVEL_SD_MM))
    slipped = [[slipped_scene(scene, place, rng.normal(0, may_slip.sd())) for place in stage_mm] for _ in range(RUNS)]
    poses = [[true_pose(one, place) for one, place in zip(both, stage_mm, strict=True)] for both in slipped]
    # All runs are traced at once: the simulator's cost is that of a call, not of a ray.
    points = [[corner_mm @ pose.rotation[:, :2].T + pose.centre_mm for pose in both] for both in poses]
    wet_exact = seen_points(scene, np.reshape(points, (-1, 3)), wet=True).reshape(RUNS, 2, -1, 2)
    squares = []
    for run in range(RUNS):
        lens = rng.multivariate_normal(truth, lens_covariance)
        travel = Travel(40.0 + rng.normal(0, TRAVEL_SD_MM), TRAVEL_SD_MM)
        dry, wet = (
            {
                p: [panel_view(scene, corner_mm, stage_mm[p], rng=rng, sd_px=CORNER_SD_PX, exact=exact[p])]
                for p in (0, 1)
            }
            for exact in (dry_exact, wet_exact[run])
        )
        known = [
            lens_known(lens, lens_covariance),
            travel_known(*AIR_PANELS, travel_mm=travel.distance_mm, sd_mm=travel.sd_mm),
        ]
        found = wet_poses(first, dry, wet, n_liquid=scene.n_liquid, slipping=may_slip, known=known)
        error = []
        for pose, name in zip(poses[run], WET_PANELS, strict=True):
            off = slip(pose, found.state.panels[name])
            error += [pose.rotation @ off[:3], pose.rotation @ off[3:]]
        squares.append(chi_square(np.concatenate(error), found.covariance_of(*WET_PANELS)))
    assert_of_unit_variance(squares, numbers=12)
