"""Where the display stands at its two positions, from photos of the board that it shows, tank dry."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from recon.calibration.bundle import BundleResult, Constraint, Media, Sighting, adjust
from recon.calibration.bundle_state import BundleState, Freedom
from recon.calibration.constraints import (
    glass_known,
    lens_known,
    scale_known,
    slip,
    travel_known,
    turn_between,
)
from recon.calibration.detection import BoardView
from recon.calibration.errors import CalibrationError
from recon.calibration.lens import Lens, camera_matrix
from recon.calibration.sight_line import PanelPose
from recon.calibration.significance import equivalent_sigma
from recon.sessions.manifest import CoverGlass, Pose

AIR_PANELS = ("pos0_air", "pos1_air")
# A straight stage is called crooked once in 400 calibrations.
STRAIGHT_SIGMA = 3.0


@dataclass(frozen=True, slots=True)
class Travel:
    """How far the stage carried the display from position 0 to position 1, and how well that is known."""

    distance_mm: float
    sd_mm: float


@dataclass(frozen=True, slots=True)
class PitchKnowledge:
    """How well the display's pitch is known, as a share; it is estimated only where this is given."""

    sd_share: float


@dataclass(frozen=True, slots=True)
class GlassKnowledge:
    """How well the cover glass's thickness is known beforehand; it is estimated only where this is given."""

    sd_mm: float


@dataclass(frozen=True, slots=True)
class Straightness:
    """Whether the stage moved the display straight.

    Attributes
    ----------
    turn_rad, turn_sd_rad : by how much the display turned on its way, and how sure that is.
    travel_mm, travel_sd_mm : how far it moved.
    lean_rad : the angle between the way it went and its own normal: how the display sits on the stage, no fault.
    sigma : how sure it is that the display turned at all, in standard deviations.
    """

    turn_rad: float
    turn_sd_rad: float
    travel_mm: float
    travel_sd_mm: float
    lean_rad: float
    sigma: float

    def sentence(self) -> str:
        """Say what was found."""
        turn_deg, sd_deg = np.degrees(self.turn_rad), np.degrees(self.turn_sd_rad)
        if self.sigma <= STRAIGHT_SIGMA:
            return (
                f"straight: the display turned by {turn_deg:.3f}° ± {sd_deg:.3f}° on its way of {self.travel_mm:.3f} mm"
            )
        return (
            f"not straight: the display turned by {turn_deg:.3f}° ± {sd_deg:.3f}° on its way of {self.travel_mm:.3f} mm; "
            "both poses are measured, so results stay right if it does so every time; look after the stage's guide"
        )


def start_pose(view: BoardView, lens: Lens) -> PanelPose:
    """Return the pose of a panel from one view of its board, without glass or liquid; a beginning, no result."""
    if len(view.corner) < 4:
        raise CalibrationError(
            f"board{' in ' + view.name if view.name else ''}: {len(view.corner)} corners were found, 4 are needed; "
            "show the board again, sharp, unobstructed and not overexposed"
        )
    board = np.column_stack([view.board_mm, np.zeros(len(view.corner))])
    found, turn, shift = cv2.solvePnP(
        board, view.place_px, camera_matrix(lens), np.ascontiguousarray(lens[4:]), flags=cv2.SOLVEPNP_IPPE
    )
    if not found:
        raise CalibrationError("board: its corners lie on one line; show more of it")
    return PanelPose(cv2.Rodrigues(turn)[0], np.asarray(shift, np.float64).ravel())


def display_poses(
    views: Mapping[int, Sequence[BoardView]],
    *,
    lens: Lens,
    lens_covariance: Float64[np.ndarray, "9 9"],
    travel: Travel | None,
    cover_glass: CoverGlass | None = None,
    glass: GlassKnowledge | None = None,
    pitch: PitchKnowledge | None = None,
    n_air: float = 1.0,
    other_views: Sequence[BoardView] = (),
) -> BundleResult:
    """Adjust the display's poses at positions 0 and 1 together, with the lens as well as it is known.

    Parameters
    ----------
    views : at each position one or more photos of the board on the display, ``board_mm`` in screen mm.
    lens, lens_covariance : as :func:`~recon.calibration.intrinsics.calibrate_lens` found them; adjusted within that.
    travel : the stage's way, a soft constraint on the distance of the two centres.
    cover_glass : over the pixels; its thickness is estimated where ``glass`` says how well it is known.
    pitch : the display's true pitch over its nominal one is estimated where this is given; only ``travel`` tells it.
    other_views : further photos of the board on the display, each in a pose of its own (oblique ones show the glass).

    Returns
    -------
    The adjustment; its panels are ``pos0_air`` and ``pos1_air``, in the camera's frame.
    """
    if set(views) != {0, 1} or not all(views.values()):
        raise CalibrationError("display poses: photos of the board are needed at positions 0 and 1")
    if pitch is not None and travel is None:
        raise CalibrationError(
            "display pitch: only the stage's travel tells it; give the travel, or take the pitch as known"
        )
    sightings = [Sighting(view, AIR_PANELS[position]) for position in (0, 1) for view in views[position]]
    panels = {AIR_PANELS[position]: start_pose(views[position][0], lens) for position in (0, 1)}
    for number, view in enumerate(other_views):
        sightings.append(Sighting(view, f"other{number}"))
        panels[f"other{number}"] = start_pose(view, lens)
    constraints: list[Constraint] = [lens_known(lens, lens_covariance)]
    if travel is not None:
        constraints.append(travel_known(*AIR_PANELS, travel_mm=travel.distance_mm, sd_mm=travel.sd_mm))
    if pitch is not None:
        constraints.append(scale_known(sd=pitch.sd_share))
    thickness_mm = cover_glass.thickness_mm if cover_glass else 0.0
    if glass is not None:
        if cover_glass is None:
            raise CalibrationError("cover glass: give its index and about how thick it is, so that it can be estimated")
        constraints.append(glass_known(thickness_mm, sd_mm=glass.sd_mm))
    return adjust(
        BundleState(lens, panels, glass_mm=thickness_mm),
        sightings,
        freedom=Freedom(lens=True, glass=glass is not None, scale=pitch is not None),
        media=Media(n_air=n_air, n_glass=cover_glass.n if cover_glass else 1.0),
        constraints=constraints,
    )


def straightness(result: BundleResult) -> Straightness:
    """Return whether the display turned between its positions, judged by the adjustment's own covariance."""
    first, second = (result.state.panels[name] for name in AIR_PANELS)
    return straightness_between(first, second, result.covariance_of(*AIR_PANELS))


def straightness_between(first: PanelPose, second: PanelPose, covariance: Float64[np.ndarray, "12 12"]) -> Straightness:
    """Return whether the display turned between two poses with this joint covariance."""
    turn = turn_between(first, second)
    by_turn = np.hstack([-first.rotation.T, np.zeros((3, 3)), first.rotation.T, np.zeros((3, 3))])
    turn_covariance = by_turn @ covariance @ by_turn.T
    way = second.centre_mm - first.centre_mm
    distance_mm = float(np.linalg.norm(way))
    by_way = np.concatenate([np.zeros(3), -way, np.zeros(3), way]) / distance_mm
    return Straightness(
        turn_rad=float(np.linalg.norm(turn)),
        turn_sd_rad=float(np.sqrt(np.trace(turn_covariance))),
        travel_mm=distance_mm,
        travel_sd_mm=float(np.sqrt(by_way @ covariance @ by_way)),
        lean_rad=float(np.arccos(np.clip(abs(way @ first.rotation[:, 2]) / distance_mm, 0.0, 1.0))),
        sigma=equivalent_sigma(turn, turn_covariance),
    )


def manifest_pose(pose: PanelPose) -> Pose:
    """Return the pose as a manifest has it; the world is the camera's frame."""
    x_axis, y_axis = pose.rotation[:, 0], pose.rotation[:, 1]
    return Pose(centre_mm=tuple(pose.centre_mm), x_axis=tuple(x_axis), y_axis=tuple(y_axis))


def panel_pose(pose: Pose) -> PanelPose:
    """Return a manifest's pose as the adjustment has it."""
    world_from_screen = pose.world_from_screen()
    return PanelPose(np.ascontiguousarray(world_from_screen[:3, :3]), np.ascontiguousarray(world_from_screen[:3, 3]))


__all__ = [
    "AIR_PANELS",
    "GlassKnowledge",
    "PitchKnowledge",
    "Straightness",
    "Travel",
    "display_poses",
    "manifest_pose",
    "panel_pose",
    "slip",
    "start_pose",
    "straightness",
    "straightness_between",
]
