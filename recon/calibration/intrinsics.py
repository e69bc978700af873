"""The camera's lens from photos of a board in many poses: OpenCV's calibration, with how sure it is and which views disagree."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from recon.calibration.coverage import Coverage, advice, coverage
from recon.calibration.detection import BoardView
from recon.calibration.errors import CalibrationError
from recon.calibration.lens import LENS_NAMES, Lens, camera_matrix
from recon.calibration.sight_line import PanelPose

FEWEST_VIEWS = 3
FEWEST_CORNERS_A_VIEW = 8
# A view whose residual is this many times the typical one is not the same board, or was shaken.
OUTLIER_RATIO = 3.0
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-12)


@dataclass(frozen=True, slots=True, eq=False)
class LensEstimate:
    """The nine numbers of the lens (:data:`~recon.calibration.lens.LENS_NAMES`), and how well the views agree on them.

    Attributes
    ----------
    covariance : of the nine numbers, scaled by the residuals; poses of the board are marginalised.
    corner_sd_px : standard deviation of a corner along each axis, from the residuals.
    views : those that were used; the following are in their order.
    view_rms_px : root mean square reprojection error of each view, over both axes.
    residual_px : measured less predicted place of every corner of each view.
    outliers : names of the views that disagree with the others.
    advice : poses that are missing, in plain words; empty where the views suffice.
    """

    lens: Lens
    covariance: Float64[np.ndarray, "9 9"]
    corner_sd_px: float
    rms_px: float
    views: tuple[BoardView, ...]
    view_rms_px: tuple[float, ...]
    residual_px: tuple[Float64[np.ndarray, "_ 2"], ...]
    poses: tuple[PanelPose, ...]
    outliers: tuple[str, ...]
    coverage: Coverage
    advice: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the views that were used."""
        return tuple(view.name for view in self.views)

    def sd(self) -> dict[str, float]:
        """Return the standard deviation of each number by name."""
        return dict(zip(LENS_NAMES, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def calibrate_lens(views: Sequence[BoardView], *, columns: int, rows: int) -> LensEstimate:
    """Calibrate a lens from views of one board.

    Parameters
    ----------
    views : photos of the board; those with fewer than eight corners are left out.
    columns, rows : size of the photos in px.

    Raises
    ------
    CalibrationError
        Where fewer than three views are left.

    Notes
    -----
    With J = [A B], A the derivatives by the lens and B those by the views' poses, the lens's covariance is
    σ² (Σ AᵀA − AᵀB (BᵀB)⁻¹ BᵀA)⁻¹ over the views, σ² the sum of squares over its degrees of freedom.
    """
    usable = [view for view in views if len(view.corner) >= FEWEST_CORNERS_A_VIEW]
    if len(usable) < FEWEST_VIEWS:
        raise CalibrationError(
            f"camera: {len(usable)} of {len(views)} photos show at least {FEWEST_CORNERS_A_VIEW} corners of the board, "
            f"{FEWEST_VIEWS} are needed; photograph the whole board, sharp and evenly lit"
        )
    board = [np.column_stack([view.board_mm, np.zeros(len(view.corner))]).astype(np.float32) for view in usable]
    photo = [view.place_px.astype(np.float32) for view in usable]
    _, matrix, distortion, turns, shifts, *_ = cv2.calibrateCameraExtended(
        board, photo, (columns, rows), None, None, criteria=STOP
    )
    lens = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()[:5]])
    poses = tuple(
        PanelPose(cv2.Rodrigues(turn)[0], np.asarray(shift, np.float64).ravel())
        for turn, shift in zip(turns, shifts, strict=True)
    )
    residuals, information = [], np.zeros((9, 9))
    for view, turn, shift in zip(usable, turns, shifts, strict=True):
        residual, seen = _linearised(view, lens, turn, shift)
        residuals.append(residual)
        information += seen
    squares = sum(float((residual**2).sum()) for residual in residuals)
    count = 2 * sum(len(residual) for residual in residuals)
    freedom = count - 9 - 6 * len(usable)
    variance = squares / max(freedom, 1)
    view_rms = tuple(float(np.sqrt((residual**2).sum(axis=1).mean())) for residual in residuals)
    spread = coverage(usable, poses, columns=columns, rows=rows)
    return LensEstimate(
        lens=lens,
        covariance=variance * np.linalg.inv(information),
        corner_sd_px=float(np.sqrt(variance)),
        rms_px=float(np.sqrt(2 * squares / count)),
        views=tuple(usable),
        view_rms_px=view_rms,
        residual_px=tuple(residuals),
        poses=poses,
        outliers=_outliers(usable, view_rms),
        coverage=spread,
        advice=advice(spread),
    )


def without_views(views: Sequence[BoardView], names: Sequence[str]) -> tuple[BoardView, ...]:
    """Return the views less those that are named; a name that no view has is a ``CalibrationError``."""
    unknown = sorted(set(names) - {view.name for view in views})
    if unknown:
        raise CalibrationError(f"camera: no view is called {', '.join(unknown)}")
    return tuple(view for view in views if view.name not in names)


def _linearised(view: BoardView, lens: Lens, turn: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a view's residuals [corners, 2] and what it tells of the lens once its own pose is eliminated [9, 9]."""
    board = np.column_stack([view.board_mm, np.zeros(len(view.corner))])
    predicted, jacobian = cv2.projectPoints(board, turn, shift, camera_matrix(lens), lens[4:])[:2]
    by_pose, by_lens = jacobian[:, :6], jacobian[:, 6:15]
    mixed = by_lens.T @ by_pose
    seen = by_lens.T @ by_lens - mixed @ np.linalg.solve(by_pose.T @ by_pose, mixed.T)
    return view.place_px - predicted.reshape(-1, 2), seen


def _outliers(views: Sequence[BoardView], view_rms_px: tuple[float, ...]) -> tuple[str, ...]:
    limit = OUTLIER_RATIO * float(np.median(view_rms_px))
    return tuple(view.name for view, rms in zip(views, view_rms_px, strict=True) if rms > limit)
