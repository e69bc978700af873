"""A photo of a board that does not serve is told why in one sentence."""

import cv2
import numpy as np
import pytest

from recon.calibration.board import Board, opencv_board
from recon.calibration.detection import detect_board
from recon.calibration.photo_faults import board_fault, edge_width_px

BOARD = Board(7, 5, 20.0)


def picture(board: Board = BOARD, *, square_px: int = 60) -> np.ndarray:
    """A board as the camera would see it: grey levels 30 to 220, a margin round it."""
    size = (board.squares_x * square_px + 60, board.squares_y * square_px + 60)
    drawn = opencv_board(board).generateImage(size, marginSize=30, borderBits=1)
    return (30 + drawn.astype(float) * 190 / 255).astype(np.uint8)


def fault_of(photo: np.ndarray, board: Board = BOARD) -> str | None:
    return board_fault(photo, board, detect_board(photo, board))


def test_a_sharp_photo_of_the_board_has_no_fault() -> None:
    assert fault_of(cv2.GaussianBlur(picture(), (0, 0), 1.0)) is None


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_a_dark_photo_is_called_dark(share: float) -> None:
    fault = fault_of((picture() * share).astype(np.uint8))
    assert fault is not None
    assert "the photo is dark" in fault


def test_markers_of_another_dictionary_are_named() -> None:
    fault = fault_of(picture(Board(7, 5, 20.0, dictionary="DICT_4X4_50")))
    assert fault is not None
    assert fault.startswith("the markers are of DICT_4X4, the board should have those of DICT_5X5_250")


def test_a_board_with_another_number_of_squares_across_is_not_taken_for_ours() -> None:
    fault = fault_of(picture(Board(10, 7, 20.0), square_px=50))
    assert fault is not None
    assert "but not as on a board of 7 x 5 squares" in fault


def test_a_blurred_photo_is_told_with_the_width_of_its_edges() -> None:
    fault = fault_of(cv2.GaussianBlur(picture(square_px=120), (0, 0), 4.0))
    assert fault is not None
    assert fault.startswith("the photo is blurred, edges are ")


def test_an_overexposed_photo_is_called_clipped() -> None:
    fault = fault_of(np.full((300, 400), 255, np.uint8))
    assert fault is not None
    assert fault.startswith("100 % of the photo is clipped white")


def test_a_photo_without_a_board_says_so() -> None:
    grey = np.random.default_rng(1).normal(120, 10, (300, 400)).astype(np.uint8)
    assert fault_of(grey) == "no board is seen; show all of it, sharp, still and evenly lit"


@pytest.mark.parametrize("blur_px", [2.0, 4.0])
def test_an_edge_blurred_by_a_gaussian_is_as_wide_as_its_steepest_slope_says(blur_px: float) -> None:
    """A step of height h blurred by s rises by h / (√(2π) s) a pixel at its steepest."""
    photo = cv2.GaussianBlur(picture(square_px=120).astype(np.float32), (0, 0), blur_px)
    view = detect_board(picture(square_px=120), BOARD)
    assert edge_width_px(photo, view) == pytest.approx(np.sqrt(2 * np.pi) * blur_px, rel=0.15)
