"""What is wrong with a photo of the calibration board, in one sentence: dark, bright, another board, blurred, or no board."""

import cv2
import numpy as np

from recon.calibration.board import Board
from recon.calibration.detection import BoardView

# Below this share of the range the brightest parts of a photo are too dark for markers to be read.
DARKEST_SHARE = 0.12
# So much of a photo at the top of the range, and white spreads over black.
LARGEST_CLIPPED_SHARE = 0.2
FEWEST_MARKERS = 3
# The edge of a square may be so much of its side wide; a marker's cells are a twelfth of a square, and are not read much later.
WIDEST_EDGE_SHARE = 0.06
WIDEST_EDGE_PX = 5.0
FAMILIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")


def board_fault(grey: np.ndarray, board: Board, view: BoardView) -> str | None:
    """Return what is wrong with a photo [rows, cols] in which ``view`` was found, or None where it serves.

    A sentence begins with what was found and ends with what to try.
    """
    photo = grey if grey.dtype == np.uint8 else cv2.convertScaleAbs(grey, alpha=255 / 65535)
    if len(view.corner):
        return _blurred(photo, view)
    brightest = float(np.percentile(photo, 99.5))
    if brightest < 255 * DARKEST_SHARE:
        return f"the photo is dark, its brightest parts are {brightest:.0f} of 255; brighten display or room, or expose longer"
    ours = _markers(photo, board.dictionary)
    if len(ours) >= FEWEST_MARKERS:
        wanted = (board.squares_x * board.squares_y) // 2
        return (
            f"{len(ours)} markers of {board.dictionary} are seen, but not as on a board of {board.squares_x} x {board.squares_y} "
            f"squares with {wanted} of them; show all of it, and check how many squares it has and that they are large enough"
        )
    for family in FAMILIES:
        theirs = _markers(photo, family)
        if family[:8] != board.dictionary[:8] and len(theirs) >= FEWEST_MARKERS:
            return (
                f"the markers are of {family.rsplit('_', 1)[0]}, the board should have those of {board.dictionary}; take the "
                "right board, or say which dictionary this one has"
            )
    clipped = float((photo >= 254).mean())
    if clipped > LARGEST_CLIPPED_SHARE:
        return f"{100 * clipped:.0f} % of the photo is clipped white; dim display or room, or expose shorter"
    return "no board is seen; show all of it, sharp, still and evenly lit"


def edge_width_px(grey: np.ndarray, view: BoardView) -> float:
    """Return how wide the edges of the squares are in a photo: contrast over steepest slope about each corner, the median.

    An edge blurred by a Gaussian of standard deviation s is √(2π) s wide.
    """
    photo = grey.astype(np.float32)
    down, across = np.gradient(photo)
    slope = np.hypot(down, across)
    half = max(3, int(0.3 * square_side_px(view)))
    widths = []
    for column, row in np.rint(view.place_px).astype(int):
        part = np.s_[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
        contrast = float(np.ptp(photo[part])) if photo[part].size else 0.0
        steepest = float(slope[part].max(initial=0.0))
        if steepest > 0:
            widths.append(contrast / steepest)
    return float(np.median(widths)) if widths else 0.0


def square_side_px(view: BoardView) -> float:
    """Return the side of a square in the photo: the median way from each corner to the nearest other one."""
    apart = np.linalg.norm(view.place_px[:, None] - view.place_px[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(np.median(apart.min(axis=1)))


def _blurred(photo: np.ndarray, view: BoardView) -> str | None:
    width_px, side_px = edge_width_px(photo, view), square_side_px(view)
    if width_px <= max(WIDEST_EDGE_PX, WIDEST_EDGE_SHARE * side_px):
        return None
    return f"the photo is blurred, edges are {width_px:.1f} px wide; hold the board still, focus, and take it again"


def _markers(photo: np.ndarray, dictionary: str) -> np.ndarray:
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)))
    _, number, _ = detector.detectMarkers(photo)
    return np.zeros(0, np.int64) if number is None else np.unique(number)
