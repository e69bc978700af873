"""From the kept photos of a calibration to ``calibration.json``; needs neither camera nor configuration file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from recon.calibration.assembly import assemble, layout_found
from recon.calibration.bundle import BundleResult, Constraint
from recon.calibration.calibration_file import (
    CALIBRATION_NAME,
    Calibration,
    CalibrationProvenance,
    write_calibration,
)
from recon.calibration.constraints import glass_known, lens_known, scale_known, travel_known
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import (
    AIR_PANELS,
    GlassKnowledge,
    PitchKnowledge,
    Travel,
    display_poses,
    straightness,
)
from recon.calibration.fep_error import Geometry, dome_geometry
from recon.calibration.intrinsics import LensEstimate, calibrate_lens
from recon.calibration.wet_pose import slips, wet_poses
from recon.media.stated_index import PROVISIONAL_N, index_of
from recon.report.calibration_page import CALIBRATION_PAGE_NAME, calibration_verdict, write_calibration_page
from rig.calibrating.kept_photos import CAMERA, DRY, WET, Begun, KeptPhoto, begun_with, kept_photos, read_view
from rig.config import RigConfig
from rig.errors import CaptureError

Say = Callable[[str], None]
# Glass of which nobody has said the index: what its error means for a point hardly depends on it.
ORDINARY_GLASS_N = 1.52


@dataclass(frozen=True, slots=True, eq=False)
class ReadPhotos:
    """The photos of one part with what was found in them."""

    photos: tuple[KeptPhoto, ...]
    views: tuple[BoardView, ...]

    def at_positions(self) -> dict[int, list[BoardView]]:
        """Return the views by position of the display."""
        found: dict[int, list[BoardView]] = {0: [], 1: []}
        for photo, view in zip(self.photos, self.views, strict=True):
            if photo.position is not None:
                found[photo.position].append(view)
        return found


def compute_calibration(folder: Path, say: Say) -> Calibration:
    """Compute everything from the kept photos, write ``calibration.json`` and its page, and say what came of it.

    Raises
    ------
    CaptureError, CalibrationError, SessionError
        One sentence: what is missing or does not fit, and which command mends it.
    """
    begun = begun_with(folder)
    if begun is None:
        raise CaptureError(f"{folder}: holds no photos of a board; begin with `rig calibrate run {folder}`")
    config = begun.config
    camera, dry, wet = (_read(folder, part, config) for part in (CAMERA, DRY, WET))
    if not camera.views:
        raise CaptureError(f"{folder}: no photos for the lens; take them with `rig calibrate camera {folder}`")
    if not all(dry.at_positions().values()):
        raise CaptureError(
            f"{folder}: no photos of the board at both positions; take them with `rig calibrate poses {folder}`"
        )
    lens = calibrate_lens(camera.views, columns=config.camera.columns, rows=config.camera.rows)
    for line in lens_text(lens):
        say(line)
    poses = adjusted_poses(lens, dry.at_positions(), wet.at_positions(), config)
    for line in poses_text(poses, config):
        say(line)
    made = assemble(
        lens,
        poses,
        _geometry(poses, config),
        board=dry.photos[0].board,
        layout=layout_found([*camera.views, *dry.views, *wet.views]),
        camera=config.camera.model_copy(update={"settings": begun.settings}),
        display=config.display,
        provenance=_provenance(begun, (*camera.photos, *dry.photos, *wet.photos)),
        valid_days=config.calibrate.valid_days,
    )
    say(quality_text(made, config))
    write_calibration(folder / CALIBRATION_NAME, made)
    write_calibration_page(folder / CALIBRATION_PAGE_NAME, made)
    verdict = calibration_verdict(made)
    for reason in verdict.reasons:
        say(f"! {reason}")
    say(f"{verdict.grade.upper()}: {verdict.next_action}")
    say(f"{folder / CALIBRATION_PAGE_NAME}: the report")
    return made


def adjusted_poses(
    lens: LensEstimate, dry: dict[int, list[BoardView]], wet: dict[int, list[BoardView]], config: RigConfig
) -> BundleResult:
    """Return the display's poses, dry and where there are photos wet, with all that the configuration knows beforehand."""
    given, stage = config.calibrate, config.stage
    travel = Travel(abs(stage.position_1_mm - stage.position_0_mm), given.travel_sd_mm)
    pitch = PitchKnowledge(given.pitch_sd) if given.pitch_sd is not None else None
    glass = GlassKnowledge(given.glass_sd_mm) if given.glass_sd_mm is not None else None
    cover_glass = config.display.cover_glass
    first = display_poses(
        dry,
        lens=lens.lens,
        lens_covariance=lens.covariance,
        travel=travel,
        cover_glass=cover_glass,
        glass=glass,
        pitch=pitch,
        n_air=config.n_air,
    )
    if not any(wet.values()) or config.liquid is None:
        return first
    known: list[Constraint] = [
        lens_known(lens.lens, lens.covariance),
        travel_known(*AIR_PANELS, travel_mm=travel.distance_mm, sd_mm=travel.sd_mm),
    ]
    if pitch is not None:
        known.append(scale_known(sd=pitch.sd_share))
    if glass is not None and cover_glass is not None:
        known.append(glass_known(cover_glass.thickness_mm, sd_mm=glass.sd_mm))
    liquid = index_of(config.liquid, primary=config.display.primary)
    if liquid is None:
        raise CaptureError(
            "the display under liquid: its pose needs the liquid's index; give n, or for water temperature_c, in [liquid]"
        )
    return wet_poses(
        first,
        dry,
        wet,
        n_liquid=liquid.n,
        n_air=config.n_air,
        cover_glass=cover_glass,
        known=known,
    )


def lens_text(lens: LensEstimate) -> list[str]:
    """Say what the lens is and how well it is known; views that disagree are named."""
    sd = lens.sd()
    lines = [
        f"lens: focal {lens.lens[0]:.2f} ± {sd['focal_x_px']:.2f} and {lens.lens[1]:.2f} ± {sd['focal_y_px']:.2f} px, centre "
        f"{lens.lens[2]:.2f} ± {sd['centre_x_px']:.2f}, {lens.lens[3]:.2f} ± {sd['centre_y_px']:.2f} px; residual "
        f"{lens.rms_px:.3f} px over {len(lens.names)} views"
    ]
    for name in lens.outliers:
        rms_px = lens.view_rms_px[lens.names.index(name)]
        lines.append(f"! view {name}: {rms_px:.2f} px, it disagrees with the others; look at it, or --leave-out {name}")
    return lines


def poses_text(poses: BundleResult, config: RigConfig) -> list[str]:
    """Say how the stage went, whether the display slipped, and which pitch was found."""
    lines = [f"stage: {straightness(poses).sentence()}"]
    lines += [f"under liquid, {slip.sentence()}" for slip in slips(poses)]
    if config.calibrate.pitch_sd is not None:
        pitch_mm = config.display.pitch_mm * poses.state.scale
        sd_mm = config.display.pitch_mm * float(np.sqrt(poses.covariance_of("scale")[0, 0]))
        lines.append(f"pitch: {pitch_mm:.6f} ± {sd_mm:.6f} mm")
    return lines


def quality_text(made: Calibration, config: RigConfig) -> str:
    """Say what the calibration's own error means at an object."""
    quality = made.quality
    text = f"corners: {quality.corner_sd_px:.3f} px, {quality.corners} of them, {quality.corners_dropped} left out"
    if quality.fep_error_mm is None or quality.normal_error_deg is None:
        return text
    given = config.calibrate
    return (
        f"{text}; for half a ball of {given.object_radius_mm:g} mm that is {quality.fep_error_mm:.3f} mm in its place, "
        f"{quality.fep_shape_error_mm:.4f} mm in its shape, {quality.normal_error_deg:.4f}° in its normals"
    )


def _read(folder: Path, part: str, config: RigConfig) -> ReadPhotos:
    photos = kept_photos(folder, part)
    return ReadPhotos(photos, tuple(read_view(folder, photo, config) for photo in photos))


def _geometry(poses: BundleResult, config: RigConfig) -> Geometry | None:
    """Return the half ball for which the calibration's error is told; None for a rig without liquid."""
    if config.liquid is None:
        return None
    given = config.calibrate
    return dome_geometry(
        poses.state.panels,
        radius_mm=given.object_radius_mm,
        n_object=config.object.n or ORDINARY_GLASS_N,
        n_liquid=config.liquid.n or PROVISIONAL_N,
        n_air=config.n_air,
        gap_mm=given.object_gap_mm,
        cover_glass=config.display.cover_glass,
    )


def _provenance(begun: Begun, photos: Sequence[KeptPhoto]) -> CalibrationProvenance:
    return CalibrationProvenance(
        software={"refractive-scan": version("refractive-scan")},
        devices=begun.devices,
        photos=tuple(photo.used for photo in photos),
        configuration={"rig": begun.config.model_dump(mode="json")},
    )
