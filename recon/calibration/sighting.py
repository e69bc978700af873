"""Photos of the board on the display, all their corners at once: how far each is from where a state of the rig puts it, and why.

A corner is compared on the screen, where the exact path from the camera ends (:mod:`recon.calibration.sight_line`), and the
difference is carried back to the photo by the path's own derivative: no search for the path is needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64

from recon.calibration.bundle_state import GLASS, LENS, LIQUID, SCALE, BundleState, ParameterTable, moved_pose, tilted
from recon.calibration.detection import BoardView
from recon.calibration.lens import Lens, camera_matrix, solve_2_by_2, view_rays
from recon.calibration.sight_line import LiquidPlane, PanelPose, bent, under_surface, upright_places

# Half a step of the derivatives that carry a difference on the screen back to the photo.
NUDGE_PX = 0.5
AROUND = NUDGE_PX * np.array([[0.0, 0.0], [1, 0], [-1, 0], [0, 1], [0, -1]])


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One photo of the board on the display: where the panel stood (a name), and whether liquid lay before it."""

    view: BoardView
    panel: str
    wet: bool = False


@dataclass(frozen=True, slots=True)
class Media:
    """Refractive indices: of air, of the liquid, of the cover glass."""

    n_air: float = 1.0
    n_liquid: float = 1.0
    n_glass: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """The corners of several sightings, one after the other.

    Attributes
    ----------
    panel : number of the panel, in the order of ``panels``, that each corner lies on.
    first : where each sighting begins, and where the last one ends.
    """

    panels: tuple[str, ...]
    place_px: Float64[np.ndarray, "corners 2"]
    board_mm: Float64[np.ndarray, "corners 2"]
    panel: Int64[np.ndarray, " corners"]
    wet: Bool[np.ndarray, " corners"]
    first: tuple[int, ...]

    @classmethod
    def of(cls, sightings: Sequence[Sighting], panels: Sequence[str]) -> "Corners":
        """Put the corners of all sightings into one row."""
        counts = [len(one.view.corner) for one in sightings]
        return cls(
            tuple(panels),
            np.concatenate([one.view.place_px for one in sightings]),
            np.concatenate([one.view.board_mm for one in sightings]),
            np.repeat(np.array([list(panels).index(one.panel) for one in sightings], dtype=np.int64), counts),
            np.repeat(np.array([one.wet for one in sightings], dtype=bool), counts),
            tuple(int(each) for each in np.cumsum([0, *counts])),
        )

    def split(self, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the part of each sighting of what stands in one row for all corners."""
        return tuple(values[start:stop] for start, stop in zip(self.first, self.first[1:], strict=False))


def corner_residuals(state: BundleState, corners: Corners, *, media: Media) -> Float64[np.ndarray, "corners 2"]:
    """Return measured less predicted places in the photo, px."""
    seen, mm_per_px = _seen_around(state, corners, media)
    return solve_2_by_2(mm_per_px, seen - state.scale * corners.board_mm)


def corner_derivatives(
    state: BundleState, corners: Corners, table: ParameterTable, *, media: Media
) -> Float64[np.ndarray, "corners 2 parameters"]:
    """Return the derivatives of :func:`corner_residuals` by the free parameters.

    The path's own derivative, which carries a difference to the photo, is taken as constant: it changes by parts in a thousand
    while the differences are parts of a pixel.
    """
    _, mm_per_px = _seen_around(state, corners, media)
    out = np.zeros((len(corners.place_px), 2, table.count))
    ray = view_rays(corners.place_px, state.lens)
    if LENS in table.parts:
        out[:, :, table.part(LENS)] = -_by_lens(ray, state.lens)
    if SCALE in table.parts:
        out[:, :, table.part(SCALE)] = solve_2_by_2(mm_per_px, -corners.board_mm)[:, :, None]
    if GLASS in table.parts:
        step = float(table.nudge[table.part(GLASS)][0])
        ahead, behind = (
            _seen(replace(state, glass_mm=state.glass_mm + sign * step), ray, corners, media) for sign in (1, -1)
        )
        out[:, :, table.part(GLASS)] = solve_2_by_2(mm_per_px, (ahead - behind) / (2 * step))[:, :, None]
    if LIQUID in table.parts and state.liquid is not None:
        part = table.part(LIQUID)
        for number, step in enumerate(table.nudge[part]):
            nudge = np.zeros(3)
            nudge[number] = step
            ahead, behind = (
                _seen(replace(state, liquid=tilted(state.liquid, sign * nudge)), ray, corners, media)
                for sign in (1, -1)
            )
            out[:, :, part.start + number] = solve_2_by_2(mm_per_px, (ahead - behind) / (2 * step))
    by_pose = _by_pose(state, ray, corners, table, media)
    for number, name in enumerate(corners.panels):
        on_it = corners.panel == number
        part = table.part(name)
        for one in range(6):
            out[on_it, :, part.start + one] = solve_2_by_2(mm_per_px[on_it], by_pose[on_it, :, one])
    return out


def _seen_around(
    state: BundleState, corners: Corners, media: Media
) -> tuple[Float64[np.ndarray, "corners 2"], Float64[np.ndarray, "corners 2 2"]]:
    """Return where on the screen the corners' places in the photo end, mm, and the derivative of that by the place."""
    places = (corners.place_px[None] + AROUND[:, None]).reshape(-1, 2)
    ray = view_rays(places, state.lens)
    start, direction = _before_panel(state.liquid, ray, np.tile(corners.wet, len(AROUND)), media)
    poses = [state.panels[name] for name in corners.panels]
    on_panel, wet = np.tile(corners.panel, len(AROUND)), np.tile(corners.wet, len(AROUND))
    seen = _on_screen(start, direction, poses, on_panel, wet, state.glass_mm, media).reshape(len(AROUND), -1, 2)
    return seen[0], np.stack([seen[1] - seen[2], seen[3] - seen[4]], axis=2) / (2 * NUDGE_PX)


def _seen(state: BundleState, ray: np.ndarray, corners: Corners, media: Media) -> Float64[np.ndarray, "rays 2"]:
    """Return where on its screen each ray ends, mm."""
    start, direction = _before_panel(state.liquid, ray, corners.wet, media)
    poses = [state.panels[name] for name in corners.panels]
    return _on_screen(start, direction, poses, corners.panel, corners.wet, state.glass_mm, media)


def _before_panel(
    liquid: LiquidPlane | None, ray: np.ndarray, wet: np.ndarray, media: Media
) -> tuple[np.ndarray, np.ndarray]:
    """Return where light last changed its direction before the panel, and its direction from there."""
    start, direction = np.zeros_like(ray), ray
    if liquid is not None and wet.any():
        direction = ray.copy()
        start[wet], direction[wet] = under_surface(ray[wet], liquid, n_air=media.n_air, n_liquid=media.n_liquid)
    return start, direction


def _on_screen(
    start: np.ndarray,
    direction: np.ndarray,
    poses: Sequence[PanelPose],
    panel: np.ndarray,
    wet: np.ndarray,
    glass_mm: float,
    media: Media,
) -> Float64[np.ndarray, "rays 2"]:
    rotation = np.stack([pose.rotation for pose in poses])[panel]
    centre = np.stack([pose.centre_mm for pose in poses])[panel]
    start = np.einsum("kji,kj->ki", rotation, start - centre)
    direction = np.einsum("kji,kj->ki", rotation, direction)
    inside = direction
    if glass_mm != 0:
        inside = np.empty_like(direction)
        for one, n_medium in ((wet, media.n_liquid), (~wet, media.n_air)):
            inside[one] = bent(direction[one], np.array([0.0, 0.0, 1.0]), n_from=n_medium, n_to=media.n_glass)
    return upright_places(start, direction, inside, glass_mm=glass_mm)


def _by_pose(
    state: BundleState, ray: np.ndarray, corners: Corners, table: ParameterTable, media: Media
) -> Float64[np.ndarray, "corners 2 6"]:
    """Return how the place on the screen moves with each number of the pose of the corner's own panel: central differences."""
    start, direction = _before_panel(state.liquid, ray, corners.wet, media)
    out = np.empty((len(ray), 2, 6))
    for number in range(6):
        steps = np.array([table.nudge[table.part(name)][number] for name in corners.panels])
        ends = []
        for sign in (1, -1):
            by = np.zeros(6)
            poses = []
            for name, step in zip(corners.panels, steps, strict=True):
                by[number] = sign * step
                poses.append(moved_pose(state.panels[name], by))
            ends.append(_on_screen(start, direction, poses, corners.panel, corners.wet, state.glass_mm, media))
        out[:, :, number] = (ends[0] - ends[1]) / (2 * steps[corners.panel])[:, None]
    return out


def _by_lens(ray: np.ndarray, lens: Lens) -> Float64[np.ndarray, "corners 2 9"]:
    """Return how the photo's place of a direction moves with the nine numbers of the lens."""
    nothing = np.zeros(3)
    jacobian = cv2.projectPoints(ray / ray[:, 2:], nothing, nothing, camera_matrix(lens), lens[4:])[1]
    return np.asarray(jacobian[:, 6:15], np.float64).reshape(-1, 2, 9)
