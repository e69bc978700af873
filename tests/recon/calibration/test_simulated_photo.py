"""From simulated photos to poses: the board shown, photographed with the object in place, found, and adjusted; dry and wet.

The photos have blur, noise and JPEG; the glass hemisphere hides a part of the board and shows another part displaced.
"""

import numpy as np
import pytest
import simplejpeg
from seen_corners import lab_scene, seen_places, true_lens, true_pose

from drivers.protocols import Frame
from recon.calibration.board import ShownBoard, board_for_display
from recon.calibration.constraints import lens_known, slip, travel_known
from recon.calibration.detection import BoardView, detect_board
from recon.calibration.display_poses import AIR_PANELS, Travel, display_poses
from recon.calibration.wet_pose import WET_PANELS, slips, wet_poses
from recon.sessions.manifest import DisplayPanel
from sim_backend.photography import Photographer
from sim_backend.scene import Scene

# A third of the camera's pixels, which keeps the tracing short: a photo of the whole panel.
COLUMNS = 1296
BLUR_PX = 0.7
# A tenth of a pixel is the rule of thumb for corners of a ChArUco board; ours must be better than that.
LARGEST_SD_PX = 0.08
SIGMA = 4.5


@pytest.fixture(scope="module")
def scene() -> Scene:
    small = lab_scene().resized(camera_columns=COLUMNS)
    return small.model_copy(update={"camera": small.camera.model_copy(update={"blur_px": BLUR_PX})})


@pytest.fixture(scope="module")
def shown(scene: Scene) -> ShownBoard:
    panel = scene.display
    return board_for_display(DisplayPanel(columns=panel.columns, rows=panel.rows, pitch_mm=panel.pitch_mm))


@pytest.fixture(scope="module")
def photos(scene: Scene, shown: ShownBoard) -> dict[str, BoardView]:
    """The board as found in a photo of each set."""
    photographer = Photographer(scene)
    found = {}
    for name in (*AIR_PANELS, *WET_PANELS):
        data = photographer.photograph(
            Frame(image=shown.image), stage_position_mm=stage_of(scene, name), wet=name.endswith("liquid")
        )
        found[name] = detect_board(simplejpeg.decode_jpeg(data, "GRAY")[:, :, 0], shown.board, name=name)
    return found


def stage_of(scene: Scene, name: str) -> float:
    return scene.stage_positions_mm[int(name[3])]


@pytest.mark.slow
def test_corners_beside_the_object_are_found_to_less_than_a_tenth_of_a_pixel_and_those_through_it_are_left_out(
    scene: Scene, shown: ShownBoard, photos: dict[str, BoardView]
) -> None:
    for name, view in photos.items():
        true_px = seen_places(scene, view.board_mm, stage_of(scene, name), wet=name.endswith("liquid"))
        off = view.place_px - true_px
        assert len(view.corner) > 0.6 * len(shown.board.corner_mm()), name
        assert np.abs(off).max() < 1.0, name  # none through the object: those are off by many pixels
        sd_px = off.std()
        assert sd_px < LARGEST_SD_PX, name
        assert np.abs(off.mean(axis=0)).max() < SIGMA * sd_px / np.sqrt(len(off)), name


@pytest.mark.slow
def test_poses_from_photos_are_within_their_covariance_of_the_truth(scene: Scene, photos: dict[str, BoardView]) -> None:
    # The lens is known as a calibration leaves it; its own error is part of the covariance.
    lens_sd = np.array([0.3, 0.3, 0.3, 0.3, 1e-3, 7e-3, 6e-5, 7e-5, 2e-2])
    lens = np.random.default_rng(11).normal(true_lens(scene), lens_sd)
    travel = Travel(40.0, 0.02)
    dry = {position: [photos[AIR_PANELS[position]]] for position in (0, 1)}
    wet = {position: [photos[WET_PANELS[position]]] for position in (0, 1)}
    first = display_poses(dry, lens=lens, lens_covariance=np.diag(lens_sd**2), travel=travel)
    known = [
        lens_known(lens, np.diag(lens_sd**2)),
        travel_known(*AIR_PANELS, travel_mm=travel.distance_mm, sd_mm=travel.sd_mm),
    ]
    assert scene.n_liquid is not None
    second = wet_poses(first, dry, wet, n_liquid=scene.n_liquid, known=known)
    for result, names in ((first, AIR_PANELS), (second, (*AIR_PANELS, *WET_PANELS))):
        for name in names:
            pose = true_pose(scene, stage_of(scene, name))
            off = slip(pose, result.state.panels[name])
            error = np.concatenate([pose.rotation @ off[:3], pose.rotation @ off[3:]])
            sd = np.sqrt(np.diag(result.covariance_of(name)))
            assert (np.abs(error) < SIGMA * sd).all(), f"{name}: {error / sd}"
    assert not any(one.found() for one in slips(second))
