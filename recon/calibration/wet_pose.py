"""Where the display stands under liquid, measured again through the liquid's flat surface, and whether it slipped since.

The photos taken dry and wet are adjusted together: the lens is one, the liquid's surface is a plane of unknown height and
lean, and each of the four poses is free. Seen from one camera, a higher level looks much like a deeper display; what the photos
leave open is closed by how little a panel on a stage slips along its normal, and :class:`Slip` says which of its numbers the
photos determined.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.calibration.bundle import BundleResult, Constraint, Media, Sighting, adjust
from recon.calibration.bundle_state import GLASS, SCALE, BundleState, Freedom
from recon.calibration.constraints import level_known, slip, slipped_little
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS
from recon.calibration.errors import CalibrationError
from recon.calibration.sight_line import LiquidPlane, PanelPose
from recon.calibration.significance import equivalent_sigma
from recon.sessions.manifest import CoverGlass

WET_PANELS = ("pos0_liquid", "pos1_liquid")
FOUND_SIGMA = 4.0  # at two positions: 1 in 8,000 without any slip
# The photos determined a number if it is known this much better than before.
DETERMINED_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class SlipKnowledge:
    """How far a panel may have moved between sets, as standard deviations.

    In its plane (mm, and rad about its normal) a tablet slides in its holder; along its normal, and in its lean, the holder keeps
    it: this is what the photos tell least, so it must be known.
    """

    in_plane_mm: float = 2.0
    in_plane_rad: float = 0.02
    along_normal_mm: float = 0.05
    lean_rad: float = 0.0005

    def sd(self) -> tuple[float, ...]:
        """Return the six, turns about x, y, z first, then shifts."""
        return (
            self.lean_rad,
            self.lean_rad,
            self.in_plane_rad,
            self.in_plane_mm,
            self.in_plane_mm,
            self.along_normal_mm,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Slip:
    """How a panel moved between dry and wet, about and along its own axes: turns (rad), then shifts (mm).

    ``determined`` tells which of the six the photos fixed, rather than what was known before.
    """

    position: int
    moved: Float64[np.ndarray, " 6"]
    covariance: Float64[np.ndarray, "6 6"]
    determined: tuple[bool, ...]

    def shift_mm(self) -> float:
        """Return the shift in the panel's plane."""
        return float(np.hypot(self.moved[3], self.moved[4]))

    def sigma(self) -> float:
        """Return how sure the motion in the plane is: shift and turn, as one normal number."""
        part = [2, 3, 4]
        return equivalent_sigma(self.moved[part], self.covariance[np.ix_(part, part)])

    def found(self) -> bool:
        """Tell whether the panel moved."""
        return self.sigma() > FOUND_SIGMA

    def sentence(self) -> str:
        """Say what was found, and what to do about it."""
        sd_mm = float(np.sqrt(np.trace(self.covariance[3:5, 3:5])))
        measured = f"{self.shift_mm():.3f} mm ± {sd_mm:.3f} mm in its plane, turned {np.degrees(self.moved[2]):.3f}°"
        if not self.found():
            return f"position {self.position}: the display is where it was ({measured})"
        return f"position {self.position}: the display slipped by {measured}; its measured pose is used; fasten it in its holder"


def wet_poses(
    dry: BundleResult,
    dry_views: Mapping[int, Sequence[BoardView]],
    wet_views: Mapping[int, Sequence[BoardView]],
    *,
    n_liquid: float,
    level: LiquidPlane | None = None,
    level_sd_mm: float = np.inf,
    level_tilt_sd_rad: float = 0.1,
    n_air: float = 1.0,
    cover_glass: CoverGlass | None = None,
    slipping: SlipKnowledge | None = None,
    known: Sequence[Constraint] = (),
    other_views: Sequence[BoardView] = (),
) -> BundleResult:
    """Adjust dry and wet poses, the lens and the liquid's surface together.

    Parameters
    ----------
    dry : the adjustment of the dry photos, from which this one starts.
    dry_views, wet_views : photos of the board at each position; corners seen through the object must be left out.
    n_liquid : index of the liquid at the display's colour.
    level : where the liquid's surface is, if that is known: its direction stays from session to session while the camera does.
        Otherwise it is taken as parallel to the display, to within the sd that follow.
    level_sd_mm, level_tilt_sd_rad : how well its distance and its direction are known.
    slipping : how far the panel may have moved.
    known : what was known for ``dry`` besides its photos: the constraints on the lens and on the stage. The cover glass's
        thickness and the pitch are adjusted again where a constraint on them is among these.
    other_views : those of ``dry``, in the same order.

    Returns
    -------
    The adjustment; its panels are ``pos0_air``, ``pos1_air`` and, where photos are given, ``pos0_liquid``, ``pos1_liquid``.
    """
    positions = [position for position in (0, 1) if wet_views.get(position)]
    if not positions:
        raise CalibrationError("display under liquid: no photo of the board; show it again with the tank filled")
    away = dry.state.panels[AIR_PANELS[0]].rotation[:, 2]
    nearest_mm = min(float(dry.state.panels[name].centre_mm @ away) for name in AIR_PANELS)
    start = level or LiquidPlane(away, 0.9 * nearest_mm)
    panels = {name: dry.state.panels[name] for name in AIR_PANELS}
    constraints = [*known, level_known(start, tilt_sd_rad=level_tilt_sd_rad, distance_sd_mm=level_sd_mm)]
    sightings = [Sighting(view, AIR_PANELS[position]) for position in (0, 1) for view in dry_views.get(position, ())]
    for number, view in enumerate(other_views):
        sightings.append(Sighting(view, f"other{number}"))
        panels[f"other{number}"] = dry.state.panels[f"other{number}"]
    may_slip = (slipping or SlipKnowledge()).sd()
    for position in positions:
        panels[WET_PANELS[position]] = panels[AIR_PANELS[position]]
        constraints.append(slipped_little(AIR_PANELS[position], WET_PANELS[position], sd=may_slip))
        sightings += [Sighting(view, WET_PANELS[position], wet=True) for view in wet_views[position]]
    begin = BundleState(dry.state.lens, panels, start, dry.state.glass_mm, dry.state.scale)
    told = {part for one in known for part in one.derivatives(begin)}
    return adjust(
        begin,
        sightings,
        freedom=Freedom(lens=True, liquid=True, glass=GLASS in told, scale=SCALE in told),
        media=Media(n_air=n_air, n_liquid=n_liquid, n_glass=cover_glass.n if cover_glass else 1.0),
        constraints=constraints,
        corner_sd_px=dry.corner_sd_px,
    )


def slips(result: BundleResult, *, slipping: SlipKnowledge | None = None) -> tuple[Slip, ...]:
    """Return how the panel moved between dry and wet at each position that was photographed wet."""
    panels = result.state.panels
    return tuple(
        slip_between(position, panels[dry], panels[wet], result.covariance_of(dry, wet), slipping=slipping)
        for position, (dry, wet) in enumerate(zip(AIR_PANELS, WET_PANELS, strict=True))
        if wet in panels
    )


def slip_between(
    position: int,
    dry: PanelPose,
    wet: PanelPose,
    covariance: Float64[np.ndarray, "12 12"],
    *,
    slipping: SlipKnowledge | None = None,
) -> Slip:
    """Return how the panel moved between two poses with this joint covariance."""
    across = dry.rotation.T
    # Rotating the first panel also turns the axes along which the shift is told: left out, it is slip times sd.
    nothing = np.zeros((3, 3))
    jacobian = np.block([[-across, nothing, across, nothing], [nothing, -across, nothing, across]])
    moved = jacobian @ covariance @ jacobian.T
    determined = np.sqrt(np.diag(moved)) < DETERMINED_SHARE * np.array((slipping or SlipKnowledge()).sd())
    return Slip(position, slip(dry, wet), moved, tuple(map(bool, determined)))
