"""Find a board's corners in a photo, to a few hundredths of a pixel.

OpenCV's ChArUco detector names the corners; each is then refined where the two diagonals of grey cross
(``cornerSubPix``), in a window that stays clear of the markers. Corners that do not fit the others, such as those of markers
seen *through* the object, are left out.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64

from recon.calibration.board import Board, Layout, opencv_board

FoundLayout = Literal["new", "legacy", "either", "none"]

# A corner farther than this share of a square from where its neighbours put it is another one's, or seen through the object.
STRAY_SHARE = 0.1
# A plane's photo needs four corners; with fewer than this nothing tells a stray from a good one.
FEWEST_CORNERS = 6
WINDOW_SHARE = 0.7  # of the margin between a corner and the nearest marker
WINDOW_PX = (2, 12)  # smaller has too few pixels, larger meets the curvature that the lens makes


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Corners of one photo: numbers, places in the photo (pixel (0, 0) is a pixel's centre), places on the board in mm.

    ``layout`` is the one that was found: ``either`` where they do not differ, ``none`` where nothing was found.
    """

    corner: Int64[np.ndarray, " corners"]
    place_px: Float64[np.ndarray, "corners 2"]
    board_mm: Float64[np.ndarray, "corners 2"]
    layout: FoundLayout
    name: str = ""

    def part(self, keep: Bool[np.ndarray, " corners"]) -> "BoardView":
        """Return the view with only the corners to keep."""
        return BoardView(self.corner[keep], self.place_px[keep], self.board_mm[keep], self.layout, self.name)


def detect_board(grey: np.ndarray, board: Board, *, name: str = "") -> BoardView:
    """Return the board's corners in a photo [rows, cols], uint8 or uint16; both layouts are tried.

    A photo without the board gives a view without corners.
    """
    photo = grey if grey.dtype == np.uint8 else cv2.convertScaleAbs(grey, alpha=255 / 65535)
    layouts: tuple[Layout, ...] = (board.layout,)
    if board.has_two_layouts():
        layouts = ("new", "legacy") if board.layout == "new" else ("legacy", "new")
    found = {layout: _corners(photo, board.with_layout(layout)) for layout in layouts}
    best = max(layouts, key=lambda layout: len(found[layout][0]))
    corner, place_px = found[best]
    layout: FoundLayout = "none" if not len(corner) else best if board.has_two_layouts() else "either"
    return BoardView(corner, place_px, board.corner_mm()[corner], layout, name)


def outside(view: BoardView, region: Bool[np.ndarray, "rows cols"]) -> BoardView:
    """Return the view without the corners in a region of the photo, such as the object's mask."""
    rows, cols = region.shape
    column = np.clip(np.rint(view.place_px[:, 0]).astype(int), 0, cols - 1)
    row = np.clip(np.rint(view.place_px[:, 1]).astype(int), 0, rows - 1)
    return view.part(~region[row, column])


def _corners(photo: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers and refined places of the corners that agree with each other."""
    nothing = np.zeros(0, np.int64), np.zeros((0, 2))
    detector = cv2.aruco.CharucoDetector(opencv_board(board))
    place, number, _, _ = detector.detectBoard(photo)
    if number is None or len(number) < FEWEST_CORNERS:
        return nothing
    corner, place_px = number.ravel().astype(np.int64), place.reshape(-1, 2).astype(np.float64)
    board_places = board.corner_mm()[corner] / board.square_mm
    side_px = _square_side_px(board_places, place_px)
    if not np.isfinite(side_px):
        return nothing
    fits = _consistent(board_places, place_px, tolerance_px=STRAY_SHARE * side_px)
    if np.count_nonzero(fits) < FEWEST_CORNERS:
        return nothing
    return corner[fits], _refined(photo, place_px[fits], side_px=side_px, marker_share=board.marker_share)


def _square_side_px(board_places: np.ndarray, place_px: np.ndarray) -> float:
    """Return the shortest side of a square in the photo: the smallest distance between neighbouring corners, mostly."""
    apart = np.linalg.norm(board_places[:, None] - board_places[None], axis=2)
    neighbours = np.isclose(apart, 1.0)
    distance = np.linalg.norm(place_px[:, None] - place_px[None], axis=2)[neighbours]
    return float(np.percentile(distance, 10)) if len(distance) else np.nan


def _consistent(board_places: np.ndarray, place_px: np.ndarray, *, tolerance_px: float) -> np.ndarray:
    """Return which corners fit one smooth map from board to photo: a homography, then a quadratic about it.

    The quadratic is what a lens and a liquid's flat surface bend a plane by.
    """
    homography, inlier = cv2.findHomography(board_places, place_px, cv2.RANSAC, 3 * tolerance_px)
    if homography is None:
        return np.zeros(len(place_px), bool)
    mapped = cv2.perspectiveTransform(board_places[None], homography)[0]
    miss = place_px - mapped
    fits = inlier.ravel().astype(bool)
    x, y = ((board_places - board_places.mean(axis=0)) / max(np.ptp(board_places, axis=0).max(), 1e-9)).T
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    if np.count_nonzero(fits) >= 2 * terms.shape[1]:
        bend, *_ = np.linalg.lstsq(terms[fits], miss[fits], rcond=None)
        miss = miss - terms @ bend
    return np.linalg.norm(miss, axis=1) < tolerance_px


def _refined(photo: np.ndarray, place_px: np.ndarray, *, side_px: float, marker_share: float) -> np.ndarray:
    margin_px = 0.5 * (1 - marker_share) * side_px
    half = int(np.clip(np.floor(WINDOW_SHARE * margin_px), *WINDOW_PX))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = np.ascontiguousarray(place_px, dtype=np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(photo, start, (half, half), (-1, -1), stop).reshape(-1, 2).astype(np.float64)
