"""The calibration board: a ChArUco chessboard, printed or shown on the display.

Its frame is that of a screen: x right and y down as the viewer sees it. Corner number k of a board with ``squares_x``
squares across is the inner corner in column k mod (squares_x − 1), row k div (squares_x − 1).
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from recon.calibration.errors import CalibrationError
from recon.sessions.manifest import DisplayedBoard, DisplayPanel

Layout = Literal["new", "legacy"]

# A square is drawn as ten by ten parts, six of which the marker takes: two parts of margin keep it out of a corner's window.
MARKER_SHARE = 0.6
PARTS = 10
# A marker of five by five bits with its black border: each needs a device pixel.
MARKER_CELLS = 7
# More squares than this leave the markers of a tablet seen by a 320 px camera unreadable.
SQUARES_ALONG = 16
FEWEST_SQUARES = 3
DICTIONARY = "DICT_5X5_250"
# What the journal calls photos of a board on the display.
BOARD = "board"


@dataclass(frozen=True, slots=True)
class Board:
    """A board as it is drawn.

    ``layout`` says which of its squares are black: ``new`` since OpenCV 4.6, ``legacy`` before. They differ where the number of
    rows is even. ``left_mm`` and ``top_mm`` place its top-left corner in the frame in which corner places are wanted (a
    screen's, or the board's own where both are 0).
    """

    squares_x: int
    squares_y: int
    square_mm: float
    marker_share: float = MARKER_SHARE
    dictionary: str = DICTIONARY
    layout: Layout = "new"
    left_mm: float = 0.0
    top_mm: float = 0.0

    def corner_mm(self) -> Float64[np.ndarray, "corners 2"]:
        """Return the places of all inner corners, in the order of their numbers."""
        x = self.left_mm + self.square_mm * np.arange(1, self.squares_x)
        y = self.top_mm + self.square_mm * np.arange(1, self.squares_y)
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def with_layout(self, layout: Layout) -> "Board":
        """Return the same board with its squares coloured the other way."""
        return replace(self, layout=layout)

    def has_two_layouts(self) -> bool:
        """Tell whether the two layouts of this board differ at all."""
        return self.squares_y % 2 == 0


@dataclass(frozen=True, slots=True, eq=False)
class ShownBoard:
    """A board on a display: ``image`` [rows, cols] uint8 drive levels of all device pixels, and the board in screen mm."""

    board: Board
    image: UInt8[np.ndarray, "rows cols"]
    square_px: int


def opencv_board(board: Board) -> Any:
    """Return OpenCV's own board, in units of one square.

    Raises ``CalibrationError`` for a dictionary that does not exist or has fewer markers than the board has white squares.
    """
    number = getattr(cv2.aruco, board.dictionary, None)
    if not board.dictionary.startswith("DICT_") or number is None:
        raise CalibrationError(f"board: {board.dictionary!r} is no marker dictionary of OpenCV; {DICTIONARY} is one")
    if min(board.squares_x, board.squares_y) < FEWEST_SQUARES:
        raise CalibrationError(
            f"board: {board.squares_x} x {board.squares_y} squares; at least {FEWEST_SQUARES} along each side are needed"
        )
    markers = cv2.aruco.getPredefinedDictionary(number)
    needed, there = (board.squares_x * board.squares_y + 1) // 2, len(markers.bytesList)
    if needed > there:
        raise CalibrationError(
            f"board: {board.squares_x} x {board.squares_y} squares need {needed} markers, {board.dictionary} has {there}; "
            "take larger squares"
        )
    made = cv2.aruco.CharucoBoard((board.squares_x, board.squares_y), 1.0, board.marker_share, markers)
    made.setLegacyPattern(board.layout == "legacy")
    return made


def board_for_display(
    display: DisplayPanel, *, squares_along: int = SQUARES_ALONG, white: int = 255, layout: Layout = "new"
) -> ShownBoard:
    """Return the board that fits a display, centred on it, with sharp edges exactly between device pixels.

    Parameters
    ----------
    squares_along : squares along the longer side of the panel.
    white : drive level of the white parts, where full white would saturate the camera.
    """
    placed = board_places(display, squares_along=squares_along, layout=layout)
    board, square_px = board_on(display, placed), placed.square_px
    drawn = opencv_board(board).generateImage(
        (board.squares_x * square_px, board.squares_y * square_px), marginSize=0, borderBits=1
    )
    image = np.full((display.rows, display.columns), white, np.uint8)
    rows = slice(placed.first_row, placed.first_row + drawn.shape[0])
    columns = slice(placed.first_column, placed.first_column + drawn.shape[1])
    image[rows, columns] = np.where(drawn > 127, white, 0)
    return ShownBoard(board, image, square_px)


def board_places(
    display: DisplayPanel, *, squares_along: int = SQUARES_ALONG, layout: Layout = "new"
) -> DisplayedBoard:
    """Return where the squares of the board of :func:`board_for_display` are on the display, without drawing it.

    Raises ``CalibrationError`` where so many squares do not fit the display, or the markers do not last for them.
    """
    longer = max(display.columns, display.rows)
    square_px = longer // squares_along // PARTS * PARTS or longer // squares_along
    if square_px * MARKER_SHARE < MARKER_CELLS:
        raise CalibrationError(
            f"board: {squares_along} squares along {longer} device pixels leave {square_px} for a square, "
            f"{int(np.ceil(MARKER_CELLS / MARKER_SHARE))} are needed; ask for fewer squares"
        )
    squares_x, squares_y = display.columns // square_px, display.rows // square_px
    opencv_board(Board(squares_x, squares_y, 1.0))
    return DisplayedBoard(
        squares_x=squares_x,
        squares_y=squares_y,
        square_px=square_px,
        first_column=(display.columns - squares_x * square_px) // 2,
        first_row=(display.rows - squares_y * square_px) // 2,
        marker_share=MARKER_SHARE,
        dictionary=DICTIONARY,
        layout=layout,
    )


def board_on(display: DisplayPanel, placed: DisplayedBoard) -> Board:
    """Return a displayed board in screen mm, by the display's pitch."""
    return Board(
        placed.squares_x,
        placed.squares_y,
        placed.square_px * display.pitch_mm,
        marker_share=placed.marker_share,
        dictionary=placed.dictionary,
        layout=placed.layout,
        left_mm=(placed.first_column - display.columns / 2) * display.pitch_mm,
        top_mm=(placed.first_row - display.rows / 2) * display.pitch_mm,
    )
