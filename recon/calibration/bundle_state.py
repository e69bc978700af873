"""The unknowns of the adjustment: their values, which of them are free, and how a step moves them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from recon.calibration.lens import Lens
from recon.calibration.sight_line import LiquidPlane, PanelPose

LENS, LIQUID, GLASS, SCALE = "lens", "liquid", "glass", "scale"


@dataclass(frozen=True, slots=True, eq=False)
class BundleState:
    """Values: lens, poses of the panel by name, liquid surface, thickness of the cover glass, true over nominal pitch."""

    lens: Lens
    panels: Mapping[str, PanelPose]
    liquid: LiquidPlane | None = None
    glass_mm: float = 0.0
    scale: float = 1.0


@dataclass(frozen=True, slots=True)
class Freedom:
    """Which unknowns move besides the poses of the panels. A free one that the photos hardly show needs a constraint."""

    lens: bool = True
    liquid: bool = False
    glass: bool = False
    scale: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ParameterTable:
    """Where each part's numbers stand in a step, and by how much each is nudged for its derivative.

    lens: 9 · liquid: tilt about two axes across ``down`` (rad), distance (mm) · glass: mm · scale · each panel: rotation vector
    about the camera's axes (rad), centre (mm).
    """

    parts: Mapping[str, slice]
    nudge: Float64[np.ndarray, " parameters"]

    @classmethod
    def of(cls, state: BundleState, freedom: Freedom) -> "ParameterTable":
        """Lay out the free parameters of a state."""
        nudges: dict[str, np.ndarray] = {}
        if freedom.lens:
            focal = state.lens[0]
            nudges[LENS] = np.array([1e-6 * focal] * 4 + [1e-4, 1e-3, 1e-5, 1e-5, 1e-2])
        if freedom.liquid:
            nudges[LIQUID] = np.array([1e-5, 1e-5, 1e-3])
        if freedom.glass:
            nudges[GLASS] = np.array([1e-3])
        if freedom.scale:
            nudges[SCALE] = np.array([1e-6])
        for name in state.panels:
            nudges[name] = np.array([1e-5] * 3 + [1e-3] * 3)
        parts, first = {}, 0
        for name, nudge in nudges.items():
            parts[name] = slice(first, first + len(nudge))
            first += len(nudge)
        return cls(parts, np.concatenate(list(nudges.values())))

    @property
    def count(self) -> int:
        """How many numbers are free."""
        return len(self.nudge)

    def part(self, name: str) -> slice:
        """Return where a part's numbers stand; empty for one that is not free."""
        return self.parts.get(name, slice(0, 0))

    def moved(self, state: BundleState, step: Float64[np.ndarray, " parameters"]) -> BundleState:
        """Return the state after a step."""
        moving = {name for name, part in self.parts.items() if step[part].any()}
        panels = {
            name: moved_pose(pose, step[self.parts[name]]) if name in moving else pose
            for name, pose in state.panels.items()
        }
        changes: dict[str, object] = {"panels": panels}
        if LENS in moving:
            changes["lens"] = state.lens + step[self.parts[LENS]]
        if LIQUID in moving and state.liquid is not None:
            changes["liquid"] = tilted(state.liquid, step[self.parts[LIQUID]])
        if GLASS in moving:
            changes["glass_mm"] = state.glass_mm + float(step[self.parts[GLASS]][0])
        if SCALE in moving:
            changes["scale"] = state.scale + float(step[self.parts[SCALE]][0])
        return replace(state, **changes)  # type: ignore[arg-type]  # each value is of its field's type


def moved_pose(pose: PanelPose, by: Float64[np.ndarray, " 6"]) -> PanelPose:
    """Return a pose turned by a rotation vector about the camera's axes (rad), its centre shifted along them (mm)."""
    return PanelPose(cv2.Rodrigues(by[:3])[0] @ pose.rotation, pose.centre_mm + by[3:])


def tilted(liquid: LiquidPlane, step: Float64[np.ndarray, " 3"]) -> LiquidPlane:
    """Return the surface leaning by two small angles towards the axes of :func:`across`, and farther by a distance."""
    first, second = across(liquid.down)
    down = liquid.down + step[0] * first + step[1] * second
    return LiquidPlane(down / np.linalg.norm(down), liquid.distance_mm + float(step[2]))


def across(direction: Float64[np.ndarray, " 3"]) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]]:
    """Return two unit vectors at right angles to a direction: the camera's x axis as nearly as may be, and the third."""
    x_axis = np.array([1.0, 0.0, 0.0]) if abs(direction[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = x_axis - (x_axis @ direction) * direction
    first = first / np.linalg.norm(first)
    return first, np.cross(direction, first)
