"""A photo of a board that does not serve is told why in one sentence."""

import cv2
import numpy as np
import pytest
from faults_page import OperatorReads

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


def test_a_dark_photo_is_called_dark(operator_reads: OperatorReads) -> None:
    operator_reads(fault_of((picture() * 0.05).astype(np.uint8)))


def test_markers_of_another_dictionary_are_named(operator_reads: OperatorReads) -> None:
    operator_reads(fault_of(picture(Board(7, 5, 20.0, dictionary="DICT_4X4_50"))))


def test_a_board_with_another_number_of_squares_across_is_not_taken_for_ours(operator_reads: OperatorReads) -> None:
    operator_reads(fault_of(picture(Board(10, 7, 20.0), square_px=50)))


def test_a_blurred_photo_is_told_with_the_width_of_its_edges(operator_reads: OperatorReads) -> None:
    operator_reads(fault_of(cv2.GaussianBlur(picture(square_px=120), (0, 0), 4.0)))


def test_an_overexposed_photo_is_called_clipped(operator_reads: OperatorReads) -> None:
    operator_reads(fault_of(np.full((300, 400), 255, np.uint8)))


def test_a_photo_without_a_board_says_so(operator_reads: OperatorReads) -> None:
    operator_reads(fault_of(np.random.default_rng(1).normal(120, 10, (300, 400)).astype(np.uint8)))


@pytest.mark.parametrize("blur_px", [2.0, 4.0])
def test_an_edge_blurred_by_a_gaussian_is_as_wide_as_its_steepest_slope_says(blur_px: float) -> None:
    """A step of height h blurred by s rises by h / (√(2π) s) a pixel at its steepest."""
    photo = cv2.GaussianBlur(picture(square_px=120).astype(np.float32), (0, 0), blur_px)
    view = detect_board(picture(square_px=120), BOARD)
    assert edge_width_px(photo, view) == pytest.approx(np.sqrt(2 * np.pi) * blur_px, rel=0.15)
