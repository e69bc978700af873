"""A display that slipped between its dry and its wet set, found and corrected by the session's own photos of a board.

Photos, truth and slip are the simulator's; the hemisphere stands before the middle of the board. At 280 columns a slip is known
to a tenth of a millimetre; ``tests/bench/display_slip.py`` has the figures for three tenths at a larger size.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from recon.calibration.board_photos import bent_pixels
from recon.calibration.board_stage import BoardStage, board_stage
from recon.calibration.session_poses import SessionPoses
from recon.calibration.wet_pose import Slip
from recon.evaluation.truth import load_truth
from recon.run import decode_session
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.session import Session, open_session
from recon.status import PixelStatus
from rig.capture_sections import BoardPhotos
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session
from sim_backend.disturbance import Disturbance
from sim_backend.scene import load_scene

SIZE = SceneOptions(display_columns=1024, width_px=48, step_px=16)
# The middle of the lab's camera, which sees the tablet and little else.
CAMERA = {
    "columns": 280,
    "rows": 210,
    "focal_x_px": 660.0,
    "focal_y_px": 660.3,
    "centre_x_px": 141.0,
    "centre_y_px": 103.5,
}
SLIP_MM = np.array([0.96, 0.72])
SETTINGS = Settings(threads=2, registration=False)  # what the board alone brings
SIGMA = 4.5


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    scene = open_scene("lab", SIZE).model_copy(update={"specimen": load_scene("hemisphere").specimen})
    scene = scene.model_copy(update={"camera": scene.camera.model_copy(update={**CAMERA, "blur_px": 0.3})})
    config = config_of_scene(scene, SIZE)
    board = BoardPhotos(squares_along=10, photos=2)
    config = config.model_copy(update={"capture": config.capture.model_copy(update={"board": board})})
    folder = tmp_path_factory.mktemp("slipped") / "session"
    slipped = {"pos1_liquid": Disturbance(display_shift_mm=(float(SLIP_MM[0]), float(SLIP_MM[1])))}
    simulate_session(scene, config, folder, workers=2, console=Console(quiet=True), disturbances=slipped)
    return open_session(folder)


@pytest.fixture(scope="module")
def sweeps(session: Session):
    return decode_session(session, SETTINGS)


@pytest.fixture(scope="module")
def stage(session: Session, sweeps) -> BoardStage:
    return board_stage(session, sweeps, calibration=None, object_mask=None, wanted=True)


def poses_of(stage: BoardStage) -> SessionPoses:
    assert stage.poses is not None, stage.note
    return stage.poses


def slips_of(stage: BoardStage) -> tuple[Slip, Slip]:
    first, second = poses_of(stage).slips
    return first, second


def errors(session: Session, sweeps) -> tuple[float, float, float]:
    """Return the mean errors of points (mm) and normals (deg), and the share of the judged pixels that have one."""
    truth = load_truth(session.folder)
    maps = reconstruct(session, sweeps, SETTINGS).maps
    judged = truth.judged
    found = judged & maps.valid()
    off_mm = np.linalg.norm(maps.point_mm[found] - truth.point_mm[found], axis=1)
    cosine = (maps.normal[found] * truth.normal[found]).sum(axis=1)
    return float(off_mm.mean()), float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean()), found.sum() / judged.sum()


def test_the_slip_is_found_where_it_was_made_and_nowhere_else(stage: BoardStage) -> None:
    first, second = slips_of(stage)
    assert not first.found()
    assert second.found()
    for slip, made in ((first, np.zeros(2)), (second, SLIP_MM)):
        assert (np.abs(slip.moved[3:5] - made) < SIGMA * np.sqrt(np.diag(slip.covariance)[3:5])).all()
    assert any("had slipped" in warning and "corrected" in warning for warning in stage.warnings)


def test_points_and_normals_are_those_of_a_display_that_did_not_slip(
    session: Session, sweeps, stage: BoardStage
) -> None:
    point_mm, normal_deg, complete = errors(stage.corrected_session(session), sweeps)
    harmed_mm, harmed_deg, harmed_complete = errors(session, sweeps)
    # What is left of a slip of 1.2 mm is its sd, a tenth of a millimetre.
    assert harmed_mm > 5 * point_mm
    assert harmed_deg > 5 * normal_deg
    assert complete > 0.9
    assert complete > harmed_complete


def test_no_corner_may_lie_where_the_simulator_sees_the_object(session: Session, sweeps, stage: BoardStage) -> None:
    with np.load(session.folder / "truth.npz") as truth:
        on_object = truth["status"] != 1  # 1: the pixel's light misses the object
    bent = bent_pixels(sweeps, stage.corrected(session.manifest))
    for one in session.manifest.sets:
        seen = np.all([sweeps[one.name, axis].status == PixelStatus.OK for axis in ("x", "y")], axis=0)
        assert bent[on_object & seen].all(), one.name
    # With margin and closed gaps the mask reaches less than twice 12 px beyond the outline, a circle of 44 px radius.
    assert bent.sum() < (1 + 24 / 44) ** 2 * on_object.sum()
    for one in poses_of(stage).corners:
        assert one.used >= 20, one.set


def test_what_hinders_the_measurement_is_said_and_the_poses_stay(session: Session, sweeps) -> None:
    camera = session.manifest.camera.model_copy(update={"intrinsics": None})
    without = replace(session, manifest=session.manifest.model_copy(update={"camera": camera}))
    stage = board_stage(without, sweeps, calibration=None, object_mask=None, wanted=True)
    assert "lens is not known" in stage.warnings[0]
    assert stage.corrected(without.manifest) == without.manifest
    everywhere = np.ones((camera.rows, camera.columns), dtype=bool)
    hidden = board_stage(session, sweeps, calibration=None, object_mask=everywhere, wanted=True)
    assert "pos0_air shows fewer than 8 corners" in hidden.warnings[0]
    assert board_stage(session, sweeps, calibration=None, object_mask=None, wanted=False).warnings == ()


def test_photos_of_the_board_are_in_the_session_like_any_other(session: Session) -> None:
    for one in session.manifest.sets:
        assert session.photo_file(one.name, "board", 0) == Path(session.folder, f"photos/{one.name}/board_0000.jpg")
        assert (
            session.photo_file(one.name, "board", 0).read_bytes()
            != session.photo_file(one.name, "board", 1).read_bytes()
        )
