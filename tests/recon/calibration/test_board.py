"""The board that a display shows: sharp corners where they are said to be, and found again in a photo."""

import numpy as np
import pytest

from recon.calibration.board import Board, board_for_display
from recon.calibration.detection import detect_board, outside
from recon.calibration.errors import CalibrationError
from recon.sessions.manifest import DisplayPanel

TABLET = DisplayPanel(columns=2048, rows=1536, pitch_mm=0.0962)
# OpenCV's cornerSubPix on an ideal corner that lies between two pixels finds it to a few thousandths.
IDEAL_PX = 0.02


def photo_of(image: np.ndarray) -> np.ndarray:
    """Return a camera's view with 64 photo pixels to the left of and above the panel, one device pixel each."""
    return np.pad(image, 64, constant_values=255)


def test_corners_lie_between_device_pixels_where_the_squares_change() -> None:
    shown = board_for_display(TABLET)
    corner_px = shown.board.corner_mm() / TABLET.pitch_mm - 0.5 + np.array([TABLET.columns, TABLET.rows]) / 2
    for x, y in corner_px:
        left, right = int(np.floor(x)), int(np.ceil(x))
        above, below = int(np.floor(y)), int(np.ceil(y))
        assert right - left == 1
        assert below - above == 1
        around = shown.image[[above, above, below, below], [left, right, left, right]]
        assert around[0] == around[3] != around[1] == around[2]


def test_the_board_fills_most_of_the_panel_and_is_centred() -> None:
    board = board_for_display(TABLET).board
    width_mm, height_mm = board.squares_x * board.square_mm, board.squares_y * board.square_mm
    assert width_mm > 0.9 * TABLET.columns * TABLET.pitch_mm
    assert height_mm > 0.9 * TABLET.rows * TABLET.pitch_mm
    assert board.left_mm == pytest.approx(-width_mm / 2)
    assert board.top_mm == pytest.approx(-height_mm / 2)


@pytest.mark.parametrize("layout", ["new", "legacy"])
@pytest.mark.parametrize("expected", ["new", "legacy"])
def test_either_layout_is_found_whichever_was_expected(layout: str, expected: str) -> None:
    shown = board_for_display(TABLET, layout=layout)
    assert shown.board.has_two_layouts()
    view = detect_board(photo_of(shown.image), shown.board.with_layout(expected))
    assert view.layout == layout
    assert len(view.corner) == len(shown.board.corner_mm())


def test_corners_of_a_perfect_photo_are_found_in_place() -> None:
    shown = board_for_display(TABLET)
    view = detect_board(photo_of(shown.image), shown.board)
    true_px = view.board_mm / TABLET.pitch_mm - 0.5 + np.array([TABLET.columns, TABLET.rows]) / 2 + 64
    assert np.abs(view.place_px - true_px).max() < IDEAL_PX


def test_a_sixteen_bit_photo_gives_the_same_corners() -> None:
    shown = board_for_display(TABLET)
    photo = photo_of(shown.image)
    deep = detect_board(photo.astype(np.uint16) * 257, shown.board)
    assert np.array_equal(deep.corner, detect_board(photo, shown.board).corner)


def test_a_photo_without_a_board_has_no_corners_and_no_layout() -> None:
    view = detect_board(np.full((300, 400), 128, np.uint8), board_for_display(TABLET).board)
    assert len(view.corner) == 0
    assert view.layout == "none"


def test_corners_under_a_mask_are_left_out() -> None:
    shown = board_for_display(TABLET)
    photo = photo_of(shown.image)
    view = detect_board(photo, shown.board)
    masked = np.zeros(photo.shape, bool)
    masked[:, : photo.shape[1] // 2] = True
    left = outside(view, masked)
    assert 0 < len(left.corner) < len(view.corner)
    assert left.place_px[:, 0].min() > photo.shape[1] // 2 - 1


def test_a_board_of_odd_height_has_one_layout() -> None:
    assert not Board(8, 5, 10.0).has_two_layouts()


def test_too_many_squares_for_the_panel_are_refused_in_a_sentence() -> None:
    with pytest.raises(CalibrationError, match="ask for fewer squares"):
        board_for_display(DisplayPanel(columns=100, rows=80, pitch_mm=0.1), squares_along=40)


def test_too_many_squares_for_the_dictionary_are_refused_in_a_sentence() -> None:
    with pytest.raises(CalibrationError, match="DICT_5X5_250 has 250"):
        board_for_display(TABLET, squares_along=64)
