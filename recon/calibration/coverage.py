"""What the views of a calibration cover: parts of the photo, tilts and distances; and which poses are missing, in plain words."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from recon.calibration.detection import BoardView
from recon.calibration.sight_line import PanelPose

CELLS_DOWN, CELLS_ACROSS = 6, 8
# Zhang (PAMI 2000, fig. 5): errors fall until about 45° of tilt, and 10 to 15 views suffice.
FEWEST_GOOD_VIEWS = 10
ENOUGH_TILT_RAD = np.radians(20.0)
ENOUGH_DEPTH_RATIO = 1.2
COVERED_SHARE = 0.8

PLACES = (
    ("top left", "top", "top right"),
    ("left", "middle", "right"),
    ("bottom left", "bottom", "bottom right"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Where corners were seen, and how the board was held.

    Attributes
    ----------
    corners : how many corners fell in each cell of the photo [down, across].
    farthest_px : distance of the farthest corner from the photo's middle, as a share of half its diagonal.
    tilt_rad : how far each view's board leans, about the photo's upright axis (right edge away: positive) and about its level
        axis (top edge away: positive).
    distance_mm : of the board's corners' middle from the camera in each view.
    """

    corners: Int64[np.ndarray, "down across"]
    farthest_share: float
    tilt_rad: Float64[np.ndarray, "views 2"]
    distance_mm: Float64[np.ndarray, " views"]

    def share(self) -> float:
        """Return the share of cells with corners."""
        return float((self.corners > 0).mean())


def corner_counts(views: Sequence[BoardView], *, columns: int, rows: int) -> Int64[np.ndarray, "down across"]:
    """Return how many corners of all views fell in each cell of a photo of ``columns`` by ``rows``."""
    place_px = np.concatenate([np.zeros((0, 2)), *(view.place_px for view in views)])
    counts, _, _ = np.histogram2d(
        place_px[:, 1],
        place_px[:, 0],
        bins=(CELLS_DOWN, CELLS_ACROSS),
        range=((-0.5, rows - 0.5), (-0.5, columns - 0.5)),
    )
    return counts.astype(np.int64)


def covered_ninths(corners: Int64[np.ndarray, "down across"]) -> Bool[np.ndarray, "3 3"]:
    """Tell of each ninth of the photo whether at least half of its cells have corners."""
    parts = [np.array_split(row, 3, axis=1) for row in np.array_split(corners > 0, 3, axis=0)]
    return np.array([[part.mean() >= 0.5 for part in row] for row in parts])


def coverage(views: Sequence[BoardView], poses: Sequence[PanelPose], *, columns: int, rows: int) -> Coverage:
    """Return what views of a board with these poses cover of a photo of ``columns`` by ``rows``."""
    place_px = np.concatenate([view.place_px for view in views])
    from_middle = np.linalg.norm(place_px - [(columns - 1) / 2, (rows - 1) / 2], axis=1)
    tilt = np.array([[np.arcsin(-pose.rotation[0, 2]), np.arcsin(pose.rotation[1, 2])] for pose in poses])
    middle = [
        pose.rotation[:, :2] @ view.board_mm.mean(axis=0) + pose.centre_mm
        for view, pose in zip(views, poses, strict=True)
    ]
    return Coverage(
        corners=corner_counts(views, columns=columns, rows=rows),
        farthest_share=float(from_middle.max() / (0.5 * np.hypot(columns, rows))),
        tilt_rad=tilt,
        distance_mm=np.linalg.norm(middle, axis=1),
    )


def advice(found: Coverage) -> tuple[str, ...]:
    """Return a sentence for each kind of view that is missing, the most useful first; none where the views suffice."""
    said = [*_missing_places(found), *_missing_tilts(found)]
    ratio = float(found.distance_mm.max() / found.distance_mm.min())
    if ratio < ENOUGH_DEPTH_RATIO:
        said.append("All views have the board at about the same distance: take some from nearer and some from farther.")
    missing = FEWEST_GOOD_VIEWS - len(found.distance_mm)
    if missing > 0:
        said.append(f"There are {len(found.distance_mm)} views: take at least {missing} more.")
    return tuple(said)


def _missing_places(found: Coverage) -> list[str]:
    """Name the ninths of the photo that are mostly empty."""
    covered = covered_ninths(found.corners)
    empty = [PLACES[down][across] for down in range(3) for across in range(3) if not covered[down, across]]
    if not empty:
        return []
    return [
        f"Few or no corners in these parts of the photo: {', '.join(empty)}. Hold the board there, into the corners."
    ]


def _missing_tilts(found: Coverage) -> list[str]:
    sideways, upright = found.tilt_rad.T
    wanted = (
        (sideways.max() < ENOUGH_TILT_RAD, "its right edge away from the camera"),
        (sideways.min() > -ENOUGH_TILT_RAD, "its left edge away from the camera"),
        (upright.max() < ENOUGH_TILT_RAD, "its top edge away from the camera"),
        (upright.min() > -ENOUGH_TILT_RAD, "its bottom edge away from the camera"),
    )
    return [
        f"No view has the board tilted with {words}: take one or two, by 20° to 45°."
        for missing, words in wanted
        if missing
    ]
