"""What the reference photos of a session say beside its reconstruction: rows for the report, and warnings."""

from dataclasses import dataclass

import numpy as np

from recon.maps import Maps
from recon.metrics import SceneComparison, ScenePart
from recon.scene.scene_check import SceneCheck, check_scene
from recon.scene.scene_error import ErrorScale, measured_scale
from recon.sessions.session import Session


@dataclass(frozen=True, slots=True)
class SceneStage:
    """All comparisons; ``note`` says what could not be checked, ``warnings`` what was found, a sentence each."""

    comparisons: tuple[SceneComparison, ...]
    note: str
    warnings: tuple[str, ...]


def scene_stage(session: Session, maps: Maps) -> SceneStage:
    """Compare the reference photos, and say what a shift means for the points of this very object."""
    report = check_scene(session)
    manifest = session.manifest
    valid = maps.valid()
    scale = measured_scale(
        manifest.camera,
        manifest.display_poses,
        point_mm=maps.point_mm[valid],
        angle_rad=maps.pbc_angle_rad[valid].astype(np.float64),
    )
    rows = tuple(_row(check, scale) for check in report.checks)
    warnings = tuple(
        f"The scene did not stay as it was: reference photo {row.index} of {row.set}: {finding}."
        for row in rows
        for finding in row.findings
    )
    return SceneStage(rows, report.note, warnings)


def _row(check: SceneCheck, scale: ErrorScale | None) -> SceneComparison:
    errors_mm = [
        scale.error_mm(found.shift_px, of_display=found.part == "display")
        for found in check.findings
        if scale is not None and found.cause != "light"
    ]
    return SceneComparison(
        set=check.set_name,
        index=check.index,
        across_sets=check.across_sets,
        parts=tuple(
            ScenePart(
                name=name,
                shift_px=shift.length_px,
                sd_px=float(np.hypot(*shift.sd_px) / np.sqrt(2)),
                spread_px=shift.spread_px,
                light=shift.light,
                light_sd=shift.light_sd,
            )
            for name, shift in check.parts.items()
        ),
        findings=tuple(found.text for found in check.findings),
        error_mm=max(errors_mm, default=None),
    )
