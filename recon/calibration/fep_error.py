"""What the uncertainty of the poses means for first entry points (FEPs) and normals: in mm and rad at the object.

Display places are held fixed and the poses moved, one number at a time; these derivatives and the poses' joint covariance give
each point's. Errors that all sets share mostly carry the object along as a whole; what is left after that is the error of its
shape, which is what a measurement of the object suffers.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from recon.calibration.bundle import BundleResult
from recon.calibration.bundle_state import GLASS, SCALE, moved_pose
from recon.calibration.display_poses import AIR_PANELS, manifest_pose
from recon.calibration.sight_line import PanelPose, bent, places_from
from recon.calibration.wet_pose import WET_PANELS
from recon.geometry.entry_point import entry_points
from recon.geometry.light_paths import light_paths
from recon.geometry.normals import normals_from_paths
from recon.sessions.manifest import CoverGlass

SETS = (*AIR_PANELS, *WET_PANELS)
NUDGE = np.array([1e-6] * 3 + [1e-4] * 3)  # rad, mm
NUDGE_OTHER = 1e-4  # mm of glass, or a share of the pitch

Panels = Mapping[str, PanelPose]
# FEPs and normals.
Result = tuple[Float64[np.ndarray, "points 3"], Float64[np.ndarray, "points 3"]]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Where pixels look in the four sets: screen mm by set name; and what lies before the display."""

    screen_mm: Mapping[str, Float64[np.ndarray, "points 2"]]
    n_liquid: float
    n_air: float = 1.0
    cover_glass: CoverGlass | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FepError:
    """Standard deviations that follow from the calibration alone.

    Attributes
    ----------
    sd_mm : of each FEP, root of the trace of its covariance, in the camera's frame.
    rms_mm : over all FEPs.
    display_rms_mm : the same in the frame of the display at position 0 dry, which has no error of its own there.
    shape_rms_mm : the same after the motion of the object as a whole, which the errors share, is taken off.
    normal_rms_rad : of the normals' directions.
    """

    sd_mm: Float64[np.ndarray, " points"]
    rms_mm: float
    display_rms_mm: float
    shape_rms_mm: float
    normal_rms_rad: float


def entry_points_of(geometry: Geometry, panels: Panels) -> Result:
    """Return FEPs and normals with the panels at these poses; a set without a pose of its own has that of its position dry."""
    paths = {}
    for condition, n_medium in (("liquid", geometry.n_liquid), ("air", geometry.n_air)):
        names = [f"pos{position}_{condition}" for position in (0, 1)]
        places = (geometry.screen_mm[names[0]], geometry.screen_mm[names[1]])
        equal = np.ones_like(places[0])
        paths[condition] = light_paths(
            places,
            (equal, equal),
            (manifest_pose(panels[panel_of(names[0], panels)]), manifest_pose(panels[panel_of(names[1], panels)])),
            cover_glass=geometry.cover_glass,
            n_medium=n_medium,
        )
    points = entry_points(paths["liquid"], paths["air"], weighted=True)
    normal = normals_from_paths(
        paths["liquid"].direction, paths["air"].direction, n_liquid=geometry.n_liquid, n_air=geometry.n_air
    )
    return points.point_mm, normal


def panel_of(set_name: str, panels: Panels) -> str:
    """Return the name of the pose that counts for a set."""
    return set_name if set_name in panels else f"{set_name.split('_')[0]}_air"


def fep_error(geometry: Geometry, calibration: BundleResult) -> FepError:
    """Return what the covariance of a calibration means for the FEPs of a geometry: its poses', and pitch's and glass's if free.

    ``geometry`` has the cover glass of the calibration, and its places on the screen in mm of the calibrated pitch.
    """
    names = [name for name in SETS if name in calibration.state.panels]
    panels = {name: calibration.state.panels[name] for name in names}
    others = {GLASS: _thicker, SCALE: _stretched}
    free = [name for name in others if name in calibration.table.parts]
    return fep_error_of(
        geometry, panels, calibration.covariance_of(*names, *free), others=tuple(others[name] for name in free)
    )


def fep_error_of(
    geometry: Geometry,
    panels: Panels,
    covariance: Float64[np.ndarray, "numbers numbers"],
    *,
    others: tuple[Callable[[Geometry, float], Geometry], ...] = (),
) -> FepError:
    """Return what a joint covariance means for the FEPs of a geometry.

    It holds six numbers a panel, in the order of ``panels``, and then one for each of ``others``, which change the geometry.
    """
    point_mm, _ = entry_points_of(geometry, panels)
    by_point, by_normal = [], []

    def differ(ahead: Result, behind: Result, nudge: float) -> None:
        by_point.append((ahead[0] - behind[0]) / (2 * nudge))
        by_normal.append((ahead[1] - behind[1]) / (2 * nudge))

    for name in panels:
        for number in range(6):
            step = np.zeros(6)
            step[number] = NUDGE[number]
            ahead, behind = (
                entry_points_of(geometry, {**panels, name: moved_pose(panels[name], sign * step)}) for sign in (1, -1)
            )
            differ(ahead, behind, NUDGE[number])
    for changed in others:
        ahead, behind = (entry_points_of(changed(geometry, sign * NUDGE_OTHER), panels) for sign in (1, -1))
        differ(ahead, behind, NUDGE_OTHER)
    point_jacobian, normal_jacobian = np.stack(by_point, axis=2), np.stack(by_normal, axis=2)
    sound = np.isfinite(point_jacobian).all(axis=(1, 2)) & np.isfinite(normal_jacobian).all(axis=(1, 2))
    variance = _variances(point_jacobian, covariance)
    shape = _without_motion(point_jacobian[sound], point_mm[sound])
    in_display = _in_frame_of_panel(point_jacobian, point_mm, panels)
    return FepError(
        sd_mm=np.sqrt(variance),
        rms_mm=float(np.sqrt(variance[sound].mean())),
        display_rms_mm=float(np.sqrt(_variances(in_display, covariance)[sound].mean())),
        shape_rms_mm=float(np.sqrt(_variances(shape, covariance).mean())),
        normal_rms_rad=float(np.sqrt(_variances(normal_jacobian, covariance)[sound].mean())),
    )


def _thicker(geometry: Geometry, by_mm: float) -> Geometry:
    glass = geometry.cover_glass
    if glass is None:
        return geometry
    return replace(geometry, cover_glass=CoverGlass(thickness_mm=glass.thickness_mm + by_mm, n=glass.n))


def _stretched(geometry: Geometry, by_share: float) -> Geometry:
    return replace(geometry, screen_mm={name: place * (1 + by_share) for name, place in geometry.screen_mm.items()})


def dome_geometry(
    panels: Panels,
    *,
    radius_mm: float,
    n_object: float,
    n_liquid: float,
    n_air: float = 1.0,
    gap_mm: float,
    cover_glass: CoverGlass | None = None,
    points: int = 400,
) -> Geometry:
    """Return the places that a half sphere shows: flat side to the camera, dome towards the nearer display.

    ``gap_mm`` lies between dome and nearer display, on the line from the camera to the display's centre. Rays that
    the dome reflects totally in air are left out.
    """
    dry = [panels[name] for name in AIR_PANELS]
    nearer = min(dry, key=lambda pose: float(np.linalg.norm(pose.centre_mm)))
    down = nearer.rotation[:, 2]
    centre_mm = nearer.centre_mm - (gap_mm + radius_mm) * down
    normal = _upper_half(points, down, nearer.rotation[:, 0])
    point_mm = centre_mm + radius_mm * normal
    incoming = point_mm / np.linalg.norm(point_mm, axis=1, keepdims=True)
    inside = bent(incoming, down, n_from=n_air, n_to=n_object)
    screen_mm = {}
    for condition, n_medium in (("air", n_air), ("liquid", n_liquid)):
        outside = bent(inside, normal, n_from=n_object, n_to=n_medium)
        for position in (0, 1):
            name = f"pos{position}_{condition}"
            screen_mm[name] = places_from(
                point_mm,
                outside,
                panels[panel_of(name, panels)],
                n_medium=n_medium,
                glass_mm=cover_glass.thickness_mm if cover_glass else 0.0,
                n_glass=cover_glass.n if cover_glass else 1.0,
            )
    seen = np.isfinite(np.hstack(list(screen_mm.values()))).all(axis=1)
    return Geometry({name: places[seen] for name, places in screen_mm.items()}, n_liquid, n_air, cover_glass)


def _upper_half(points: int, down: np.ndarray, x_axis: np.ndarray) -> Float64[np.ndarray, "points 3"]:
    """Return directions spread evenly between 5° and 60° about ``down`` (a spiral at the golden angle)."""
    number = np.arange(points) + 0.5
    cosine = np.cos(np.radians(5)) + (np.cos(np.radians(60)) - np.cos(np.radians(5))) * number / points
    turn = number * np.pi * (3 - np.sqrt(5))
    sine = np.sqrt(1 - cosine**2)
    y_axis = np.cross(down, x_axis)
    return np.outer(cosine, down) + np.outer(sine * np.cos(turn), x_axis) + np.outer(sine * np.sin(turn), y_axis)


def _variances(
    jacobian: Float64[np.ndarray, "points 3 numbers"], covariance: Float64[np.ndarray, "numbers numbers"]
) -> Float64[np.ndarray, " points"]:
    variance = np.einsum("pin,nm,pim->p", jacobian, covariance, jacobian)
    return np.maximum(variance, 0.0)  # rounding makes a variance of nought negative


def _in_frame_of_panel(
    jacobian: Float64[np.ndarray, "points 3 numbers"], point_mm: Float64[np.ndarray, "points 3"], panels: Panels
) -> Float64[np.ndarray, "points 3 numbers"]:
    """Take off how the points would move if they were fixed to the display at position 0."""
    names = list(panels)
    first = 6 * names.index(AIR_PANELS[0])
    arm = point_mm - panels[AIR_PANELS[0]].centre_mm
    carried = np.zeros_like(jacobian)
    for number, axis in enumerate(np.eye(3)):
        carried[:, :, first + number] = np.cross(axis, arm)
        carried[:, :, first + 3 + number] = axis
    return jacobian - carried


def _without_motion(
    jacobian: Float64[np.ndarray, "points 3 numbers"], point_mm: Float64[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points 3 numbers"]:
    """Take off what the best shift and turn of all points explain."""
    arm = point_mm - point_mm.mean(axis=0)
    motions = [np.broadcast_to(axis, arm.shape) for axis in np.eye(3)] + [np.cross(axis, arm) for axis in np.eye(3)]
    basis, _ = np.linalg.qr(np.stack(motions, axis=-1).reshape(-1, 6))
    flat = jacobian.reshape(-1, jacobian.shape[2])
    return (flat - basis @ (basis.T @ flat)).reshape(jacobian.shape)
