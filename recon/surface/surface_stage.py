"""The surface of a session: which integration each method uses, and what it needs to know of the camera."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64

from recon.geometry.sight import sight_rays
from recon.maps import Maps
from recon.reconstruct import Crossing
from recon.sessions.manifest import CameraBody, Manifest
from recon.status import PixelStatus
from recon.surface.fusion import FusedSurface, fuse_on_rays
from recon.surface.integration import integrate_perspective
from recon.surface.mesh import Mesh, mesh_from_point_map
from recon.sweeps.correspondence import Method

NO_CAMERA = (
    "The camera's place or intrinsics are not in the manifest, so normals could not be integrated on its rays; "
    "the mesh joins the points themselves."
)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The maps as the surface leaves them, the mesh, and what the reader should know."""

    maps: Maps
    mesh: Mesh | None
    warnings: tuple[str, ...] = ()


def surface_of(maps: Maps, crossing: Crossing, manifest: Manifest, *, method: Method) -> Surface:
    """Make the mesh: normals integrated on the camera's rays (paper), or positions and normals together (full)."""
    if not maps.valid().any():
        return Surface(maps, None, ("No point was found, so there is no mesh.",))
    if method == "full":
        return fused_surface(maps, crossing)
    return integrated_surface(maps, manifest.camera)


def integrated_surface(maps: Maps, camera: CameraBody) -> Surface:
    """Integrate the normals on the camera grid and mesh the result; the maps keep their own points."""
    valid = maps.valid()
    rays = sight_rays(camera)
    if rays is None:
        return Surface(maps, mesh_from_point_map(maps.point_mm, maps.normal, valid), (NO_CAMERA,))
    centre, direction = rays
    depth = ((maps.point_mm - centre) * direction).sum(axis=2)
    surface = integrate_perspective(maps.normal, valid, centre_mm=centre, direction=direction, anchor_depth_mm=depth)
    return Surface(maps, mesh_from_point_map(surface.point_mm, maps.normal, valid))


def fused_surface(maps: Maps, crossing: Crossing) -> Surface:
    """Fuse positions and normals on the paths in liquid; pixels with parallel paths get their point from their neighbours.

    A pixel's path is the mean over its footprint. Liquid bends light less than air at the same surface, so its mean path
    runs closer to the path of the pixel's centre, above all near total reflection.
    """
    shape = maps.status.shape
    surface_pixel = np.isin(crossing.status, (PixelStatus.OK, PixelStatus.PARALLEL_PATHS))
    has_point = crossing.status == PixelStatus.OK
    liquid, points = crossing.liquid, crossing.points
    along_sd = np.sqrt(np.einsum("pi,pij,pj->p", liquid.direction, points.covariance, liquid.direction))

    def on_grid(values: np.ndarray, where: np.ndarray) -> Float64[np.ndarray, "..."]:
        grid = np.full((maps.status.size, *values.shape[1:]), np.nan)
        grid[crossing.pixels[where]] = values[where]
        return grid.reshape(*shape, *values.shape[1:])

    normal = on_grid(crossing.normal, surface_pixel)
    fused = fuse_on_rays(
        on_grid(liquid.near_mm, surface_pixel),
        on_grid(liquid.direction, surface_pixel),
        on_grid(points.distance_liquid_mm, has_point),
        on_grid(along_sd, has_point),
        normal,
        on_grid(crossing.normal_sd_rad, surface_pixel),
        np.isfinite(normal).all(axis=2),
    )
    covered = np.isfinite(fused.point_mm).all(axis=2)
    status = np.where(covered, np.uint8(PixelStatus.OK), maps.status)
    lost = (status == PixelStatus.OK) & ~covered
    status[lost] = PixelStatus.PARALLEL_PATHS
    refined = replace(
        maps,
        point_mm=fused.point_mm,
        normal=np.where(covered[..., None], normal, np.nan),
        sd_mm=_sd(crossing, surface_pixel, fused, shape=maps.status.shape),
        status=status,
    )
    return Surface(refined, mesh_from_point_map(fused.point_mm, normal, covered))


def _sd(
    crossing: Crossing, surface_pixel: np.ndarray, fused: FusedSurface, *, shape: tuple[int, ...]
) -> Float32[np.ndarray, "rows cols"]:
    """Return each fused point's sd: along its ray from the surface, across it from the ray's own correspondences."""
    pixels = crossing.pixels[surface_pixel]
    distance = fused.distance_mm.ravel()
    shift = crossing.liquid.covariance_at(np.nan_to_num(distance[crossing.pixels]))
    direction = crossing.liquid.direction
    along = np.einsum("pi,pij,pj->p", direction, shift, direction)
    across = (np.trace(shift, axis1=1, axis2=2) - along)[surface_pixel]
    variance = np.full(distance.size, np.nan)
    variance[pixels] = across + fused.distance_sd_mm.ravel()[pixels] ** 2 + crossing.carried_mm2[surface_pixel]
    return np.sqrt(variance).astype(np.float32).reshape(shape)
