"""Join what was measured into one calibration: lens, poses dry and wet, their quality at an object, and the warnings."""

import numpy as np

from recon.calibration.board import Board
from recon.calibration.bundle import BundleResult
from recon.calibration.bundle_state import GLASS, SCALE
from recon.calibration.calibration_file import (
    BoardRecord,
    CalibratedCamera,
    Calibration,
    CalibrationProvenance,
    MeasuredLevel,
    Quality,
    matrix_rows,
    measured_poses,
)
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS, STRAIGHT_SIGMA, straightness
from recon.calibration.evidence import evidence_of
from recon.calibration.fep_error import Geometry, fep_error
from recon.calibration.intrinsics import LensEstimate
from recon.calibration.lens import intrinsics_of
from recon.calibration.wet_pose import slips
from recon.sessions.journal import now_text
from recon.sessions.manifest import CameraBody, CoverGlass, DisplayPanel


def assemble(
    lens: LensEstimate,
    poses: BundleResult,
    geometry: Geometry | None,
    *,
    board: Board,
    layout: str,
    camera: CameraBody,
    display: DisplayPanel,
    provenance: CalibrationProvenance,
    valid_days: float = 30.0,
) -> Calibration:
    """Return the calibration that a lens and an adjustment of the display's poses make.

    Parameters
    ----------
    poses : of :func:`~recon.calibration.display_poses.display_poses`, or of :func:`~recon.calibration.wet_pose.wet_poses`.
    geometry : the object whose points the quality is told for (:func:`~recon.calibration.fep_error.dome_geometry`);
        without one it is not told.
    layout : which layout of the board was found (``view.layout``).
    camera, display : as configured; what was measured of them replaces their numbers.
    """
    places, covariance = measured_poses(poses)
    error = fep_error(geometry, poses) if geometry is not None else None
    corners = sum(len(kept) for kept in poses.kept)
    return Calibration(
        schema_version=1,
        created=now_text(),
        valid_days=valid_days,
        display=_measured_display(display, poses),
        camera=CalibratedCamera(
            columns=camera.columns,
            rows=camera.rows,
            model=camera.model,
            settings=camera.settings,
            intrinsics=intrinsics_of(poses.state.lens),
            covariance=matrix_rows(poses.covariance_of("lens")),
            views=len(lens.names),
            rms_px=lens.rms_px,
        ),
        board=BoardRecord(
            squares_x=board.squares_x,
            squares_y=board.squares_y,
            square_mm=board.square_mm,
            dictionary=board.dictionary,
            layout=layout,  # type: ignore[arg-type]  # the model itself refuses any other word
        ),
        poses=places,
        covariance=covariance,
        level=_level(poses, geometry),
        quality=Quality(
            reprojection_rms_px=poses.rms_px,
            corner_sd_px=poses.corner_sd_px,
            corners=corners,
            corners_dropped=poses.dropped(),
            fep_error_mm=error.rms_mm if error else None,
            fep_display_error_mm=error.display_rms_mm if error else None,
            fep_shape_error_mm=error.shape_rms_mm if error else None,
            normal_error_deg=float(np.degrees(error.normal_rms_rad)) if error else None,
            pitch_sd_share=_sd_of(poses, SCALE),
            cover_glass_sd_mm=_sd_of(poses, GLASS),
        ),
        evidence=evidence_of(lens, poses, columns=camera.columns, rows=camera.rows),
        warnings=_warnings(lens, poses),
        provenance=provenance,
    )


def layout_found(views: list[BoardView]) -> str:
    """Return the layout that most views show; ``either`` where the two do not differ."""
    named = [view.layout for view in views if view.layout != "none"]
    return max(sorted(set(named)), key=named.count) if named else "either"


def _measured_display(display: DisplayPanel, poses: BundleResult) -> DisplayPanel:
    glass = display.cover_glass
    if glass is not None and poses.state.glass_mm > 0:
        glass = CoverGlass(thickness_mm=poses.state.glass_mm, n=glass.n)
    return display.model_copy(update={"pitch_mm": display.pitch_mm * poses.state.scale, "cover_glass": glass})


def _sd_of(poses: BundleResult, name: str) -> float | None:
    """Return the sd of pitch or glass; None where it was taken as given."""
    return float(np.sqrt(poses.covariance_of(name)[0, 0])) if name in poses.table.parts else None


def _level(poses: BundleResult, geometry: Geometry | None) -> MeasuredLevel | None:
    liquid = poses.state.liquid
    if liquid is None or geometry is None:
        return None
    down = tuple(float(number) for number in liquid.down)
    return MeasuredLevel(n=geometry.n_liquid, down=(down[0], down[1], down[2]), distance_mm=liquid.distance_mm)


def _warnings(lens: LensEstimate, poses: BundleResult) -> tuple[str, ...]:
    found = [f"camera: {sentence}" for sentence in lens.advice]
    if lens.outliers:
        found.append(
            f"camera: {', '.join(lens.outliers)}: not as the other views are; look whether shaken or bent, and leave out"
        )
    if set(AIR_PANELS) <= set(poses.state.panels):
        straight = straightness(poses)
        if straight.sigma > STRAIGHT_SIGMA:
            found.append(straight.sentence())
    found += [slip.sentence() for slip in slips(poses) if slip.found()]
    return tuple(found)
