"""Simulated calibrations: views of boards from the simulator's optics with noise of their own, and what is found from them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from recon.calibration.board import Board, board_for_display
from recon.calibration.bundle import BundleResult, Constraint
from recon.calibration.constraints import glass_known, lens_known, slip, travel_known
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS, GlassKnowledge, PitchKnowledge, Travel, display_poses
from recon.calibration.intrinsics import LensEstimate, calibrate_lens
from recon.calibration.sight_line import PanelPose
from recon.calibration.wet_pose import SlipKnowledge, wet_poses
from recon.sessions.manifest import CoverGlass
from sim_backend.scene import Scene
from tests.recon.calibration.seen_corners import (
    hand_held_views,
    lab_scene,
    panel_view,
    seen_places,
    slipped_scene,
    true_lens,
    true_pose,
)
from tests.recon.calibration.seen_object import OBJECT_RADIUS_MM, PANEL

TRAVEL_SD_MM = 0.02
GLASS_INDEX = 1.52
OBLIQUE_RAD = np.radians(40.0)
OBLIQUE_TURNS = 6


@dataclass(frozen=True, slots=True)
class Procedure:
    """How a calibration is made: views of the held board, its corners, photos of the display in each set, sd of a corner."""

    views: int
    board: Board
    photos: int = 4
    corner_sd_px: float = 0.05
    squares_along: int = 16

    def words(self) -> str:
        """Say it in a line."""
        corners = (self.board.squares_x - 1) * (self.board.squares_y - 1)
        return f"{self.views} views of {corners} corners"


class Rig:
    """The paper's rig with a true lens and true poses; exact places are traced once and serve all runs."""

    def __init__(self, *, squares_along: int = 16, glass_mm: float | None = None) -> None:
        self.scene: Scene = lab_scene(glass_mm=glass_mm)
        self.stage_mm = self.scene.stage_positions_mm
        self.glass = CoverGlass(thickness_mm=glass_mm, n=GLASS_INDEX) if glass_mm else None
        self.corner_mm = board_for_display(PANEL, squares_along=squares_along).board.corner_mm()
        # Under liquid the object stands in the tank: corners seen through it are left out.
        self.wet_mm = self.corner_mm[np.linalg.norm(self.corner_mm, axis=1) > 1.6 * OBJECT_RADIUS_MM]
        self.lens = true_lens(self.scene)
        self.poses = {name: true_pose(self.scene, place) for name, place in zip(AIR_PANELS, self.stage_mm, strict=True)}
        first, second = (self.poses[name] for name in AIR_PANELS)
        self.travel_mm = float(np.linalg.norm(second.centre_mm - first.centre_mm))
        assert self.scene.n_liquid is not None
        self.n_liquid: float = self.scene.n_liquid

    @cached_property
    def dry_px(self) -> list[np.ndarray]:
        """Where the corners are seen dry, by position."""
        return [seen_places(self.scene, self.corner_mm, place) for place in self.stage_mm]

    @cached_property
    def oblique(self) -> list[tuple[Scene, np.ndarray]]:
        """The display leaning six ways before the camera, and where its corners are seen."""
        found = []
        for turn in 2 * np.pi * np.arange(OBLIQUE_TURNS) / OBLIQUE_TURNS:
            lean = OBLIQUE_RAD * np.array([np.cos(turn), np.sin(turn)])
            scene = slipped_scene(self.scene, self.stage_mm[0], np.array([*lean, 0, 0, 0, 30.0]))
            found.append((scene, seen_places(scene, self.corner_mm, self.stage_mm[0])))
        return found

    def wet_px(self, slipped: tuple[Scene, Scene]) -> list[np.ndarray]:
        """Return where the corners beside the object are seen under liquid, by position."""
        return [
            seen_places(one, self.wet_mm, place, wet=True) for one, place in zip(slipped, self.stage_mm, strict=True)
        ]

    def views(
        self, exact: list[np.ndarray], corner_mm: np.ndarray, procedure: Procedure, rng: np.random.Generator
    ) -> dict[int, list[BoardView]]:
        """Return noisy photos of the display at both positions."""
        sd_px = procedure.corner_sd_px
        return {
            position: [
                panel_view(self.scene, corner_mm, self.stage_mm[position], rng=rng, sd_px=sd_px, exact=exact[position])
                for _ in range(procedure.photos)
            ]
            for position in (0, 1)
        }


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """One calibration: the lens, the poses dry, and dry and wet together where the display was seen wet."""

    lens: LensEstimate
    dry: BundleResult
    wet: BundleResult | None


def calibrate(
    rig: Rig,
    procedure: Procedure,
    rng: np.random.Generator,
    *,
    slipped: tuple[Scene, Scene] | None = None,
    slipping: SlipKnowledge | None = None,
    pitch_share: float | None = None,
    cover_glass: CoverGlass | None = None,
    glass_sd_mm: float | None = None,
    oblique: bool = False,
) -> Made:
    """Calibrate once: lens, dry poses, and poses under liquid if ``slipped`` scenes are given.

    ``cover_glass`` is what is believed of it; its thickness is estimated if ``glass_sd_mm`` says how far that may be off.
    """
    held = hand_held_views(rig.scene, procedure.board, count=procedure.views, rng=rng, sd_px=procedure.corner_sd_px)
    lens = calibrate_lens(held, columns=rig.scene.camera.columns, rows=rig.scene.camera.rows)
    travel = Travel(rig.travel_mm + rng.normal(0, TRAVEL_SD_MM), TRAVEL_SD_MM)
    dry_views = rig.views(rig.dry_px, rig.corner_mm / (pitch_share or 1.0), procedure, rng)
    leaning = [
        panel_view(scene, rig.corner_mm, 0.0, rng=rng, sd_px=procedure.corner_sd_px, exact=exact)
        for scene, exact in (rig.oblique if oblique else ())
    ]
    dry = display_poses(
        dry_views,
        lens=lens.lens,
        lens_covariance=lens.covariance,
        travel=travel,
        cover_glass=cover_glass,
        glass=GlassKnowledge(sd_mm=glass_sd_mm) if glass_sd_mm else None,
        pitch=PitchKnowledge(sd_share=0.1) if pitch_share else None,
        other_views=leaning,
    )
    if slipped is None:
        return Made(lens, dry, None)
    known: list[Constraint] = [
        lens_known(lens.lens, lens.covariance),
        travel_known(*AIR_PANELS, travel_mm=travel.distance_mm, sd_mm=travel.sd_mm),
    ]
    if glass_sd_mm and cover_glass:
        known.append(glass_known(cover_glass.thickness_mm, sd_mm=glass_sd_mm))
    wet = wet_poses(
        dry,
        dry_views,
        rig.views(rig.wet_px(slipped), rig.wet_mm, procedure, rng),
        n_liquid=rig.n_liquid,
        cover_glass=cover_glass,
        slipping=slipping,
        known=known,
        other_views=leaning,
    )
    return Made(lens, dry, wet)


def slipped_twice(rig: Rig, slipping: SlipKnowledge, rng: np.random.Generator) -> tuple[Scene, Scene]:
    """Return the rig with its display slipped at each position as far as chance has it."""
    first, second = (slipped_scene(rig.scene, place, rng.normal(0, slipping.sd())) for place in rig.stage_mm)
    return first, second


def pose_errors(truth: dict[str, PanelPose], found: BundleResult) -> np.ndarray:
    """Return the errors of the poses, six a panel, about and along the camera's axes as their covariance has them."""
    parts = []
    for name, pose in truth.items():
        error = slip(pose, found.state.panels[name])
        parts += [pose.rotation @ error[:3], pose.rotation @ error[3:]]
    return np.concatenate(parts)


def chi_square(error: np.ndarray, covariance: np.ndarray) -> float:
    """Return the square of the errors in units of their joint covariance."""
    scale = np.sqrt(np.diag(covariance))
    return float((error / scale) @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale))
