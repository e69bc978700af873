"""Where the display stood in each set of a session, from the session's own photos of a board, dry and under liquid.

The board of every set is adjusted together with what is known of the rig (:mod:`recon.calibration.prior`); each set then has its
own pose, so that a display that slipped between two sets is found and corrected (:mod:`recon.calibration.wet_pose`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from recon.calibration.board_photos import Views, bent_pixels, board_views, corner_reach_px, seen_directly
from recon.calibration.bundle import FEWEST_CORNERS, BundleResult
from recon.calibration.calibration_file import CAMERA_ITSELF, Calibration, in_world
from recon.calibration.constraints import lens_known, travel_known
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS, display_poses, manifest_pose
from recon.calibration.errors import CalibrationError
from recon.calibration.lens import intrinsics_of
from recon.calibration.prior import RigKnowledge, rig_knowledge
from recon.calibration.wet_pose import WET_PANELS, Slip, slips, wet_poses
from recon.media.stated_index import provisional
from recon.sessions.manifest import CaptureSet, Manifest
from recon.sessions.session import Session
from recon.sweeps.set_places import SweepResults

# The direction of the level stays while the camera does; a tank that was lifted and put back leans by less than this.
LEVEL_TILT_SD_RAD = 0.01
# What was known and what the photos say are this many standard deviations apart once in 16,000 times.
DISAGREEMENT_SIGMA = 4.0
LENS_NUMBERS = 9


@dataclass(frozen=True, slots=True)
class SetCorners:
    """One set's board: photos, corners found, those left out as seen through the object, those used, and their misfit."""

    set: str
    photos: int
    found: int
    through_object: int
    used: int
    rms_px: float


@dataclass(frozen=True, slots=True, eq=False)
class SessionPoses:
    """The adjustment, what it is made of, how the display slipped, and what is doubtful: ``warnings``, a sentence each."""

    result: BundleResult
    corners: tuple[SetCorners, ...]
    slips: tuple[Slip, ...]
    source: str
    warnings: tuple[str, ...]

    def sentences(self) -> tuple[str, ...]:
        """Say for each position how the display stood in liquid beside where it stood dry."""
        return tuple(slip_sentence(slip) for slip in self.slips)


def session_poses(
    session: Session,
    sweeps: SweepResults,
    *,
    calibration: Calibration | None,
    object_mask: Bool[np.ndarray, "rows cols"] | None = None,
    threads: int = 0,
) -> SessionPoses:
    """Measure the display's pose in each set.

    ``session`` has its calibration taken over; ``sweeps`` are its decoded ones, which show where the object is.

    Raises
    ------
    CalibrationError
        Where nothing is known of the lens, or a dry set shows too little of the board; the session's poses stay as they are then.
    """
    manifest = session.manifest
    known = rig_knowledge(manifest, calibration)
    if known is None:
        raise CalibrationError(
            "the camera's lens is not known, so they tell no pose; give camera.intrinsics in the manifest, or a calibration"
        )
    found = board_views(session, threads=threads)
    views = found if object_mask is None else seen_directly(found, object_mask)
    first = _dry(views, known, manifest)
    reach_px = corner_reach_px(views, manifest)
    views = seen_directly(views, bent_pixels(sweeps, with_poses(manifest, first), margin_px=reach_px))
    first = _dry(views, known, manifest)
    wet = {position: _enough(views.get(name, ())) for position, name in enumerate(WET_PANELS)}
    warnings = tuple(
        f"Board photos: {name} shows fewer than {FEWEST_CORNERS} corners past the object; its dry pose is used."
        for name, ones in zip(WET_PANELS, wet.values(), strict=True)
        if not ones and manifest.liquid is not None
    )
    result = first
    if manifest.liquid is not None and any(wet.values()):
        result = wet_poses(
            first,
            {position: _enough(views[name]) for position, name in enumerate(AIR_PANELS)},
            wet,
            n_liquid=provisional(manifest).n_liquid(),
            level=known.level,
            level_tilt_sd_rad=LEVEL_TILT_SD_RAD,
            n_air=manifest.n_air,
            cover_glass=manifest.display.cover_glass,
            known=[
                lens_known(known.lens, known.lens_covariance),
                travel_known(*AIR_PANELS, travel_mm=known.travel.distance_mm, sd_mm=known.travel.sd_mm),
            ],
        )
    return SessionPoses(
        result,
        _corners(found, views, result),
        slips(result),
        known.source,
        (*warnings, *_disagreement(result)),
    )


def with_poses(manifest: Manifest, result: BundleResult) -> Manifest:
    """Return a manifest with the measured poses of its sets and the lens of the same adjustment in place of its own.

    The camera stays where the manifest has it; one that does not say gets the camera's frame as its world.
    """
    camera_pose = manifest.camera.pose or CAMERA_ITSELF
    placed = {name: in_world(manifest_pose(panel), camera_pose) for name, panel in result.state.panels.items()}

    def own(one: CaptureSet) -> CaptureSet:
        return one.model_copy(update={"pose": placed.get(one.name) if one.name in WET_PANELS else None})

    camera = manifest.camera.model_copy(update={"pose": camera_pose, "intrinsics": intrinsics_of(result.state.lens)})
    first, second = (placed[name] for name in AIR_PANELS)
    return manifest.model_copy(
        update={"display_poses": (first, second), "camera": camera, "sets": tuple(map(own, manifest.sets))}
    )


def slip_sentence(slip: Slip) -> str:
    """Say in one line how far the display slipped in its plane, and that this is corrected."""
    shift_mm, sd_mm = slip.shift_mm(), shift_sd_mm(slip)
    if not slip.found():
        return f"display at position {slip.position} stood in the liquid where it stood dry: {shift_mm:.3f} ± {sd_mm:.3f} mm"
    turn_deg, turn_sd_deg = np.degrees(slip.moved[2]), np.degrees(np.sqrt(slip.covariance[2, 2]))
    turned = (
        f", and turned {turn_deg:.3f} ± {turn_sd_deg:.3f}°" if abs(turn_deg) > DISAGREEMENT_SIGMA * turn_sd_deg else ""
    )
    return f"display at position {slip.position} had slipped {shift_mm:.3f} ± {sd_mm:.3f} mm{turned} in the liquid set; corrected"


def shift_sd_mm(slip: Slip) -> float:
    """Return the standard deviation of the shift's length; of one direction, where there is no shift."""
    shift = slip.moved[3:5]
    length_mm = float(np.linalg.norm(shift))
    along = shift / length_mm if length_mm > 0 else np.array([1.0, 0.0])
    return float(np.sqrt(along @ slip.covariance[3:5, 3:5] @ along))


def _dry(views: Views, known: RigKnowledge, manifest: Manifest) -> BundleResult:
    dry = {position: _enough(views.get(name, ())) for position, name in enumerate(AIR_PANELS)}
    for name, ones in zip(AIR_PANELS, dry.values(), strict=True):
        if not ones:
            raise CalibrationError(
                f"{name} shows fewer than {FEWEST_CORNERS} corners past the object; show more of the board, larger squares, or "
                "leave the photos out with --no-board"
            )
    return display_poses(
        dry,
        lens=known.lens,
        lens_covariance=known.lens_covariance,
        travel=known.travel,
        cover_glass=manifest.display.cover_glass,
        n_air=manifest.n_air,
    )


def _enough(views: tuple[BoardView, ...]) -> list[BoardView]:
    return [view for view in views if len(view.corner) >= FEWEST_CORNERS]


def _corners(found: Views, views: Views, result: BundleResult) -> tuple[SetCorners, ...]:
    """Count the corners of each set; the adjustment's sightings come in the order of the panels."""
    order = [(name, view) for name in (*AIR_PANELS, *WET_PANELS) for view in _enough(views.get(name, ()))]
    squares: dict[str, list[np.ndarray]] = {}
    for (name, _), residual, kept in zip(order, result.residual_px, result.kept, strict=False):
        squares.setdefault(name, []).append((residual[kept] ** 2).sum(axis=1))
    return tuple(
        SetCorners(
            name,
            photos=len(found[name]),
            found=_count(found, name),
            through_object=_count(found, name) - _count(views, name),
            used=sum(map(len, squares.get(name, []))),
            rms_px=float(np.sqrt(np.concatenate(squares[name]).mean())) if name in squares else float("nan"),
        )
        for name in found
    )


def _count(views: Mapping[str, tuple[BoardView, ...]], name: str) -> int:
    return sum(len(view.corner) for view in views[name])


def _disagreement(result: BundleResult) -> tuple[str, ...]:
    """Say where the photos of the board do not agree with what was known of lens and travel."""
    off = np.abs(result.constraint_sigma[: LENS_NUMBERS + 1])
    if off.max() <= DISAGREEMENT_SIGMA:
        return ()
    what = "the lens" if off[:LENS_NUMBERS].max() >= off[LENS_NUMBERS:].max() else "the stage's travel"
    return (
        f"Board photos: they disagree with {what} by {off.max():.1f} standard deviations; calibrate the camera again, and "
        "look whether the index of the liquid and the cover glass are right.",
    )
