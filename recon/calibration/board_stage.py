"""What a session's own photos of a board say beside its reconstruction: the corrected manifest, rows for the report, warnings."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from recon.calibration.board_photos import has_board_photos
from recon.calibration.calibration_file import Calibration
from recon.calibration.display_poses import manifest_pose
from recon.calibration.errors import CalibrationError
from recon.calibration.session_poses import SessionPoses, session_poses, shift_sd_mm, with_poses
from recon.calibration.wet_pose import Slip
from recon.metrics import BoardResult, BoardSet, DisplaySlip
from recon.registration.gap_fit import MotionCovariance
from recon.registration.known_slips import slips_of_poses
from recon.sessions.manifest import Manifest
from recon.sessions.session import Session
from recon.sweeps.set_places import SweepResults

NO_PHOTOS = (
    "The session has no photos of a board: the display is taken to stand where the manifest or the calibration has it."
)
SWITCHED_OFF = "The session's photos of a board were not used, as asked."


@dataclass(frozen=True, slots=True, eq=False)
class BoardStage:
    """The poses as measured, None where they were not; ``note`` says why, ``warnings`` what was found."""

    poses: SessionPoses | None = None
    note: str = NO_PHOTOS
    warnings: tuple[str, ...] = ()

    def corrected(self, manifest: Manifest) -> Manifest:
        """Return a manifest of the session with the measured poses."""
        return manifest if self.poses is None else with_poses(manifest, self.poses.result)

    def corrected_session(self, session: Session) -> Session:
        """Return the session with the measured poses."""
        return replace(session, manifest=self.corrected(session.manifest))

    def slip_covariance(self) -> MotionCovariance | None:
        """Return what the photos of the board leave unknown of the slips; None where not all four poses were measured."""
        if self.poses is None:
            return None
        panels = self.poses.result.state.panels
        poses = {name: manifest_pose(panel) for name, panel in panels.items()}
        return slips_of_poses(poses, self.poses.result.covariance_of(*panels))

    def result(self) -> BoardResult | None:
        """Return the rows of the report."""
        if self.poses is None:
            return None
        return BoardResult(
            sets=tuple(
                BoardSet(
                    set=one.set,
                    photos=one.photos,
                    found=one.found,
                    through_object=one.through_object,
                    used=one.used,
                    rms_px=one.rms_px if np.isfinite(one.rms_px) else None,
                )
                for one in self.poses.corners
            ),
            slips=tuple(_row(slip) for slip in self.poses.slips),
            corner_sd_px=self.poses.result.corner_sd_px,
            source=self.poses.source,
            sentences=self.poses.sentences(),
        )


def board_stage(
    session: Session,
    sweeps: SweepResults,
    *,
    calibration: Calibration | None,
    object_mask: Bool[np.ndarray, "rows cols"] | None,
    wanted: bool,
    threads: int = 0,
) -> BoardStage:
    """Measure the display's poses anew where the session has photos of a board; what hinders it is a warning, no error."""
    if not has_board_photos(session):
        return BoardStage()
    if not wanted:
        return BoardStage(note=SWITCHED_OFF)
    try:
        poses = session_poses(session, sweeps, calibration=calibration, object_mask=object_mask, threads=threads)
    except CalibrationError as error:
        note = f"Board photos: {error}. The poses of the manifest are used."
        return BoardStage(note=note, warnings=(note,))
    slipped = tuple(
        f"The {text}; fasten the display in its holder."
        for slip, text in zip(poses.slips, poses.sentences(), strict=True)
        if slip.found()
    )
    return BoardStage(poses, "", (*slipped, *poses.warnings))


def _row(slip: Slip) -> DisplaySlip:
    sd = np.sqrt(np.diag(slip.covariance))
    return DisplaySlip(
        position=slip.position,
        in_plane_mm=slip.shift_mm(),
        in_plane_sd_mm=shift_sd_mm(slip),
        turn_deg=float(np.degrees(slip.moved[2])),
        turn_sd_deg=float(np.degrees(sd[2])),
        along_normal_mm=float(slip.moved[5]),
        along_normal_sd_mm=float(sd[5]),
        sigma=slip.sigma(),
        found=bool(slip.found()),
    )
