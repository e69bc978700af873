"""The boards of a calibration: the printed one as a picture to print or hold, and those that the display shows."""

import numpy as np
from jaxtyping import UInt8

from recon.calibration.board import FEWEST_SQUARES, Board, ShownBoard, board_for_display, opencv_board
from rig.config import RigConfig
from rig.errors import ConfigError

# Pixels of the picture along a square: a marker of 5 × 5 bits and its border take six tenths of it, in whole pixels a cell.
SQUARE_PX = 70
PRINTED_SQUARE_PX = 210
# Photos at one place show boards of different squares, so that no error of drawing or detection repeats in all of them.
SHRINKING = (1.0, 0.85, 0.7)
COARSEST = 2


def printed_board(config: RigConfig) -> Board:
    """Return the printed board as configured; raises ``ConfigError`` where nobody has measured it."""
    given = config.calibrate
    if given.square_mm is None:
        raise ConfigError(
            "calibrate.square_mm: this value is missing; measure the squares of the printed board with a caliper, over many of "
            "them, and give it in the configuration or with --square-mm"
        )
    board = Board(*given.squares, given.square_mm, dictionary=given.dictionary)
    opencv_board(board)  # refuses what cannot be drawn
    return board


def board_picture(board: Board, *, square_px: int = SQUARE_PX) -> UInt8[np.ndarray, "rows cols"]:
    """Return a board as it is printed, with a white margin of half a square."""
    margin_px = square_px // 2
    size = (board.squares_x * square_px + 2 * margin_px, board.squares_y * square_px + 2 * margin_px)
    drawn = opencv_board(board).generateImage(size, marginSize=margin_px, borderBits=1)
    return np.ascontiguousarray(drawn, dtype=np.uint8)


def shown_board(config: RigConfig, number: int = 0) -> ShownBoard:
    """Return the board that the display shows for photo ``number`` at one place."""
    given = config.calibrate
    squares = max(FEWEST_SQUARES, round(given.squares_along * SHRINKING[number % len(SHRINKING)]))
    return board_for_display(config.display, squares_along=squares, white=given.white)
