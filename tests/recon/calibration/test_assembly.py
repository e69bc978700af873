"""From views to a calibration on disk and back, with a slip, a wrong pitch and a shaken view on the way."""

from pathlib import Path

import numpy as np
from seen_corners import hand_held_views, lab_scene, panel_view, slipped_scene, true_pose

from recon.calibration.assembly import assemble, layout_found
from recon.calibration.board import Board, board_for_display
from recon.calibration.calibration_file import CalibrationProvenance, read_calibration, write_calibration
from recon.calibration.constraints import lens_known, travel_known
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS, Travel, display_poses
from recon.calibration.fep_error import dome_geometry
from recon.calibration.intrinsics import calibrate_lens
from recon.calibration.wet_pose import wet_poses
from recon.sessions.manifest import CameraBody, DisplayPanel

PANEL = DisplayPanel(columns=2048, rows=1536, pitch_mm=0.0962)
SD_PX = 0.05


def test_a_calibration_is_joined_written_and_read_with_its_warnings(tmp_path: Path) -> None:
    scene = lab_scene()
    assert scene.n_liquid is not None
    stage_mm = scene.stage_positions_mm
    rng = np.random.default_rng(6)
    views = hand_held_views(scene, Board(7, 6, 25.0), count=12, rng=rng, sd_px=SD_PX)
    shaken = views[4]
    views[4] = BoardView(
        shaken.corner,
        shaken.place_px + rng.normal(0, 8 * SD_PX, shaken.place_px.shape),
        shaken.board_mm,
        "either",
        shaken.name,
    )
    lens = calibrate_lens(views, columns=3888, rows=2592)
    board = board_for_display(PANEL, squares_along=9).board
    corner_mm = board.corner_mm()
    slipped = slipped_scene(scene, stage_mm[1], np.array([0, 0, 0, 0.3, 0, 0]))
    dry = {p: [panel_view(scene, corner_mm, stage_mm[p], rng=rng, sd_px=SD_PX)] for p in (0, 1)}
    wet = {p: [panel_view((scene, slipped)[p], corner_mm, stage_mm[p], rng=rng, sd_px=SD_PX, wet=True)] for p in (0, 1)}
    first = display_poses(dry, lens=lens.lens, lens_covariance=lens.covariance, travel=Travel(40.0, 0.02))
    known = [lens_known(lens.lens, lens.covariance), travel_known(*AIR_PANELS, travel_mm=40.0, sd_mm=0.02)]
    poses = wet_poses(first, dry, wet, n_liquid=scene.n_liquid, known=known)
    geometry = dome_geometry(poses.state.panels, radius_mm=27.99, n_object=1.5195, n_liquid=scene.n_liquid, gap_mm=25.0)
    made = assemble(
        lens,
        poses,
        geometry,
        board=board,
        layout=layout_found(views),
        camera=CameraBody(columns=3888, rows=2592, model="Canon EOS 40D", settings={"aperture": "8"}),
        display=PANEL,
        provenance=CalibrationProvenance(note="simulated corners"),
    )
    path = tmp_path / "calibration.json"
    write_calibration(path, made)
    read = read_calibration(path)
    assert read == made
    assert set(read.poses) == {"pos0_air", "pos1_air", "pos0_liquid", "pos1_liquid"}
    assert any("position 1: the display slipped" in warning for warning in read.warnings)
    assert any(shaken.name in warning for warning in read.warnings)
    assert read.level is not None
    sd_mm = np.sqrt(np.diag(poses.covariance_of("liquid")))[2]
    true_mm = (scene.liquid_level_mm or 0.0) - scene.camera.position_mm[2]
    assert abs(read.level.distance_mm - true_mm) < 4 * sd_mm
    far = np.array(read.poses["pos1_liquid"].centre_mm) - true_pose(slipped, stage_mm[1]).centre_mm
    assert (np.abs(far) < 4 * np.sqrt(np.diag(poses.covariance_of("pos1_liquid")))[3:]).all()
    quality = read.quality
    assert quality.fep_shape_error_mm is not None
    assert quality.fep_error_mm is not None
    assert 0 < quality.fep_shape_error_mm < quality.fep_error_mm
