"""Thin objects (the paper's second method): no liquid, the object in and out of the way instead.

Without the object the two display points of a pixel give its visual ray; with it they give its PBC. A calibrated camera gives the
visual ray by itself, and the two sets without the object are not needed (footnote of the paper). One refraction is assumed: the
visual ray runs on inside the object (index n) up to the surface that faces the display, so the normal there is
n·U − n_air·V (Eq. 3 with U the visual ray and V the PBC). The two rays are nearly parallel, so their crossing is a poor place:
the surface comes from integrating the normals (:mod:`recon.surface.thin_surface`).

Where the side towards the camera is known to be flat (``object.flat_face``), the method ``full`` follows the refraction there
too, and nothing is assumed.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import label

from recon.errors import SessionError
from recon.geometry.beside import straight_paths
from recon.geometry.camera_rays import camera_rays
from recon.geometry.entry_point import entry_points
from recon.geometry.flat_face import paths_inside
from recon.geometry.light_paths import LightPaths, light_paths
from recon.geometry.normals import normal_sd_rad, normals_from_paths
from recon.geometry.sight import sight_rays
from recon.maps import Maps
from recon.method import Method, ThinForm
from recon.sessions.manifest import Manifest, Pose
from recon.status import PixelStatus
from recon.surface.mesh import Mesh, mesh_from_point_map
from recon.surface.thin_surface import NOTES, USUAL_FORM, thin_surface_points
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.set_places import SweepResults, combined_status, correspondences

NEIGHBOURHOOD_PX = 7
# With the object away and in place, a pixel beside it sees the same display pixel to within this.
UNMOVED_PX = 0.05
# The paper's method knows no noise; a twentieth of a pixel is what its parabola reaches on a good day.
NOMINAL_SD_PX = 0.05
ONE_REFRACTION = (
    "One refraction is assumed: the error of the normals grows with the object's thickness, and a plane-parallel plate "
    "cannot be told from nothing."
)

FLAT_FACE = "The flat face towards the camera is known, so that both refractions are followed exactly."


PHOTOGRAPHED = "The visual rays were measured: the display was photographed without the object as well (four sets)."
FROM_CAMERA = (
    "The visual rays are those of the calibrated camera, its lens and its place (two sets): an error of its calibration turns "
    "all normals alike."
)


@dataclass(frozen=True, slots=True, eq=False)
class ThinSurface:
    """Maps, mesh and what the reader should know."""

    maps: Maps
    mesh: Mesh | None
    warnings: tuple[str, ...]


def thin_object(
    sweeps: Mapping[tuple[str, str], SweepResult],
    manifest: Manifest,
    *,
    method: Method,
    inside_mask: np.ndarray | None = None,
    integration: ThinForm | None = None,
) -> ThinSurface:
    """Reconstruct a thin object; the points lie on the visual rays, where the integrated surface meets them.

    Without ``integration`` the form is the method's own (``USUAL_FORM``).
    """
    form = integration or USUAL_FORM[method]
    n_object = manifest.object.n
    assert n_object is not None, "the manifest's own check grants the object's index to this method"
    shape = (manifest.camera.rows, manifest.camera.columns)
    status = combined_status(sweeps, manifest.sets)
    # Two light paths of a thin object bend alike, so that no test tells them apart: the one with more light counts.
    status[status == PixelStatus.TWO_PATHS] = PixelStatus.OK
    if inside_mask is not None:
        status[~inside_mask.ravel() & (status != PixelStatus.UNLIT)] = PixelStatus.MASKED_OUT
    sight = _sight(manifest) if manifest.visual_rays_from_camera else None
    matched = np.flatnonzero(status == PixelStatus.OK)
    if sight is None:
        beside = _beside(sweeps, matched, manifest, shape=shape)
    else:
        beside = _unbent(sweeps, matched, manifest, sight[0], method=method, shape=shape)
    status[beside] = PixelStatus.BESIDE_OBJECT
    pixels = np.flatnonzero(status == PixelStatus.OK)
    contact = _paths(sweeps, manifest, "with", pixels, method=method)
    if sight is None:
        visual = _paths(sweeps, manifest, "without", pixels, method=method)
    else:
        visual = camera_rays(sight[0], sight[1].reshape(-1, 3)[pixels], _poses(manifest, "with"))
    face = manifest.object.flat_face if method == "full" else None
    if face is not None:
        visual = paths_inside(visual, face, n_object=n_object, n_air=manifest.n_air)
    points = entry_points(visual, contact, weighted=method == "full")
    media = {"n_liquid": n_object, "n_air": manifest.n_air}
    normal = normals_from_paths(visual.direction, contact.direction, **media)
    along_sd = np.sqrt(np.einsum("pi,pij,pj->p", visual.direction, points.covariance, visual.direction))

    def on_grid(values: np.ndarray) -> np.ndarray:
        grid = np.full((status.size, *values.shape[1:]), np.nan)
        grid[pixels] = values
        return grid.reshape(*shape, *values.shape[1:])

    normals = on_grid(normal)
    point_mm = thin_surface_points(
        form,
        origin_mm=on_grid(visual.near_mm),
        direction=on_grid(visual.direction),
        distance_mm=on_grid(points.distance_liquid_mm),
        distance_sd_mm=on_grid(along_sd),
        normal=normals,
        normal_sd_rad=on_grid(normal_sd_rad(visual, contact, **media)),
    )
    covered = np.isfinite(point_mm).all(axis=2)
    lost = (status.reshape(shape) == PixelStatus.OK) & ~covered
    status[lost.ravel()] = PixelStatus.PARALLEL_PATHS
    maps = Maps(
        point_mm=point_mm,
        normal=np.where(covered[..., None], normals, np.nan),
        sd_mm=np.full(shape, np.nan, dtype=np.float32),
        gap_mm=on_grid(points.gap_mm).astype(np.float32),
        pbc_angle_rad=on_grid(points.angle_rad).astype(np.float32),
        status=status.reshape(shape),
    )
    mesh = mesh_from_point_map(point_mm, normals, covered) if covered.any() else None
    rays_note = PHOTOGRAPHED if sight is None else FROM_CAMERA
    return ThinSurface(maps, mesh, (rays_note, NOTES[form], ONE_REFRACTION if face is None else FLAT_FACE))


def _sight(manifest: Manifest) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's centre and rays, or say what is missing."""
    sight = sight_rays(manifest.camera)
    if sight is None:
        raise SessionError(
            "method thin with the two sets 'with' alone takes its visual rays from the camera, whose pose or lens is not known; "
            "give camera.pose and camera.intrinsics in the manifest, or a calibration with --calibration"
        )
    return sight


def _poses(manifest: Manifest, condition: str) -> tuple[Pose, Pose]:
    first, second = (manifest.set_named(f"pos{position}_{condition}") for position in (0, 1))
    return manifest.pose_of(first), manifest.pose_of(second)


def _paths(
    sweeps: SweepResults,
    manifest: Manifest,
    condition: str,
    pixels: np.ndarray,
    *,
    method: Method,
) -> LightPaths:
    sets = [manifest.set_named(f"pos{position}_{condition}") for position in (0, 1)]
    found = [correspondences(sweeps, one, manifest, pixels) for one in sets]
    nominal = np.full((len(pixels), 2), NOMINAL_SD_PX * manifest.display.pitch_mm)
    sd = [nominal if method == "paper" else one.sd_mm for one in found]
    return light_paths(
        (found[0].screen_mm, found[1].screen_mm),
        (sd[0], sd[1]),
        _poses(manifest, condition),
        cover_glass=manifest.display.cover_glass,
        n_medium=manifest.n_air,
    )


def _unbent(
    sweeps: SweepResults,
    pixels: np.ndarray,
    manifest: Manifest,
    camera_mm: np.ndarray,
    *,
    method: Method,
    shape: tuple[int, int],
) -> np.ndarray:
    """Return the pixels whose light runs straight to the camera, in regions that reach the photo's border."""
    contact = _paths(sweeps, manifest, "with", pixels, method=method)
    sd_rad = np.sqrt(np.trace(contact.direction_covariance(), axis1=1, axis2=2))
    straight = np.zeros(shape[0] * shape[1], dtype=bool)
    straight[pixels] = straight_paths(contact, camera_mm, sd_rad, pixels=pixels, shape=shape)
    return _reaching_the_border(straight.reshape(shape))


def _beside(
    sweeps: SweepResults,
    matched: np.ndarray,
    manifest: Manifest,
    *,
    shape: tuple[int, int],
) -> np.ndarray:
    """Return the pixels for which the object changes nothing, in regions that reach the photo's border."""
    unmoved = np.zeros(shape[0] * shape[1], dtype=bool)
    unmoved[matched] = True
    for position in (0, 1):
        there, gone = (
            correspondences(sweeps, manifest.set_named(f"pos{position}_{condition}"), manifest, matched).screen_mm
            for condition in ("with", "without")
        )
        total = np.zeros((*shape, 3))
        total.reshape(-1, 3)[matched] = np.concatenate(
            [(there - gone) / manifest.display.pitch_mm, np.ones((len(matched), 1))], axis=1
        )
        window = (NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX)
        total = cv2.boxFilter(total, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
        mean = total.reshape(-1, 3)
        unmoved &= np.linalg.norm(mean[:, :2], axis=1) <= UNMOVED_PX * mean[:, 2]
    return _reaching_the_border(unmoved.reshape(shape))


def _reaching_the_border(region: np.ndarray) -> np.ndarray:
    regions, _ = label(region)
    border = np.unique(np.concatenate([regions[0], regions[-1], regions[:, 0], regions[:, -1]]))
    return np.isin(regions, border[border > 0]).ravel()
