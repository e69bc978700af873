"""Photos that OpenCV's authors took, calibrated to the result that they published."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.calibration.board import Board
from recon.calibration.detection import BoardView, detect_board
from recon.calibration.intrinsics import calibrate_lens, without_views

DATA = Path(__file__).parents[2] / "data" / "opencv-calibration"
COLUMNS, ROWS = 9, 6
# Another release of OpenCV may refine corners a little differently; a tenth of a standard deviation is no other result.
SAME_SD = 0.1


@pytest.fixture(scope="module")
def views() -> list[BoardView]:
    """Corners as OpenCV's sample program finds them: cornerSubPix with a window of 11 px."""
    board_mm = 25.0 * np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)), axis=-1).reshape(-1, 2)
    found = []
    for path in sorted(DATA.glob("left*.jpg")):
        photo = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        seen, corners = cv2.findChessboardCorners(photo, (COLUMNS, ROWS), flags=flags)
        assert seen
        stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.1)
        corners = cv2.cornerSubPix(photo, corners, (11, 11), (-1, -1), stop)
        place_px = corners.reshape(-1, 2).astype(np.float64)
        found.append(BoardView(np.arange(len(board_mm)), place_px, board_mm, "either", path.stem))
    return found


def published() -> dict[str, np.ndarray]:
    """Return the published numbers."""
    file = cv2.FileStorage(str(DATA / "left_intrinsics.yml"), cv2.FILE_STORAGE_READ)
    matrix, distortion = file.getNode("camera_matrix").mat(), file.getNode("distortion_coefficients").mat()
    lens = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()]
    return {
        "lens": np.array(lens),
        "rms_px": np.array(file.getNode("avg_reprojection_error").real()),
        "view_rms_px": file.getNode("per_view_reprojection_errors").mat().ravel(),
    }


def test_the_published_lens_is_found_again(views: list[BoardView]) -> None:
    estimate = calibrate_lens(views, columns=640, rows=480)
    sd = np.sqrt(np.diag(estimate.covariance))
    assert np.abs((estimate.lens - published()["lens"]) / sd).max() < SAME_SD
    assert estimate.rms_px == pytest.approx(published()["rms_px"], abs=0.001)
    assert np.allclose(estimate.view_rms_px, published()["view_rms_px"], atol=0.002)


def test_the_view_that_stands_out_in_the_published_errors_is_named_and_can_be_removed(views: list[BoardView]) -> None:
    assert int(np.argmax(published()["view_rms_px"])) == 1  # left02, 1.18 px among 0.16 … 0.38 px
    estimate = calibrate_lens(views, columns=640, rows=480)
    assert estimate.outliers == ("left02",)
    better = calibrate_lens(without_views(views, estimate.outliers), columns=640, rows=480)
    assert "left02" not in better.names
    assert better.outliers == ()
    assert better.rms_px < 0.6 * estimate.rms_px


def test_the_covariance_agrees_with_opencvs_own_standard_deviations(views: list[BoardView]) -> None:
    estimate = calibrate_lens(views, columns=640, rows=480)
    board = [np.column_stack([view.board_mm, np.zeros(len(view.corner))]).astype(np.float32) for view in views]
    photo = [view.place_px.astype(np.float32) for view in views]
    theirs = cv2.calibrateCameraExtended(board, photo, (640, 480), None, None)[5].ravel()[:9]
    # OpenCV divides by another count of degrees of freedom: a few percent at most here.
    assert np.allclose(np.sqrt(np.diag(estimate.covariance)), theirs, rtol=0.1)


def test_a_charuco_board_among_papers_is_found_whole() -> None:
    photo = cv2.imread(str(DATA / "charuco.jpg"), cv2.IMREAD_GRAYSCALE)
    view = detect_board(photo, Board(5, 7, 40.0, marker_share=0.5, dictionary="DICT_6X6_250"))
    assert len(view.corner) == 24
    # A plane seen by a mild lens: a homography explains its corners to a few tenths of a pixel.
    homography, _ = cv2.findHomography(view.board_mm, view.place_px)
    mapped = cv2.perspectiveTransform(view.board_mm[None], homography)[0]
    assert np.sqrt(((mapped - view.place_px) ** 2).sum(axis=1).mean()) < 0.5
