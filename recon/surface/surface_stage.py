"""The surface of a session: which integration each method uses, and what it needs to know of the camera."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from recon.bands import side_by_side
from recon.geometry.sight import sight_rays
from recon.maps import Maps, Support
from recon.memory import give_back_free_memory
from recon.method import Method
from recon.photo_window import PhotoWindow
from recon.reconstruct import Crossing
from recon.sessions.manifest import CameraBody, Manifest
from recon.status import PixelStatus
from recon.surface.covering import with_covered
from recon.surface.fusion import fuse_on_rays
from recon.surface.integration import integrate_perspective
from recon.surface.mesh import Mesh, mesh_from_point_map
from recon.surface.own_paths import OwnPaths
from recon.surface.path_measurement import PathMeasurement
from recon.surface.ray_chords import Mask
from recon.surface.refinement import refine_surface
from recon.surface.second_places import SecondPlaces
from recon.surface.strays import without_strays

# No window of pixels that fusion and refinement look at reaches farther.
MARGIN_PX = 16
NO_CAMERA = (
    "The camera's place or intrinsics are not in the manifest, so normals could not be integrated on its rays; "
    "the mesh joins the points themselves."
)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The maps as the surface leaves them, what makes the mesh when it is asked for, and what the reader should know."""

    maps: Maps
    mesh: Callable[[], Mesh | None]
    warnings: tuple[str, ...] = ()


def surface_of(
    maps: Maps,
    crossing: Crossing,
    manifest: Manifest,
    *,
    method: Method,
    own: OwnPaths | None = None,
    second: SecondPlaces | None = None,
    apart: Mask | None = None,
    threads: int = 1,
) -> Surface:
    """Make the mesh: normals integrated on the camera's rays (paper), or positions and normals together (full).

    With the ``own`` paths of pixels that were left out, the surface of method ``full`` covers those that it surrounds. Pixels
    with a ``second`` place are less sure, which counts last: it says nothing of the surface that they measured. Pixels that are
    ``apart`` have a surface of their own, so that what is wrong with them does not reach the others.
    """
    if not maps.valid().any():
        return Surface(maps, lambda: None, ("No point was found, so there is no mesh.",))
    if method == "full":
        media = {"n_liquid": manifest.n_liquid(), "n_air": manifest.n_air}
        surface = _fused_apart(maps, crossing, apart, **media, threads=threads)
        whole = surface if own is None else with_covered(without_strays(surface, threads=threads), own, threads=threads)
        whole = whole if second is None else second.widened(whole)
        return Surface(whole, partial(mesh_from_point_map, whole.point_mm, whole.normal, whole.with_point()))
    return integrated_surface(maps, manifest.camera)


def integrated_surface(maps: Maps, camera: CameraBody) -> Surface:
    """Integrate the normals on the camera grid and mesh the result; the maps keep their own points."""
    valid = maps.valid()
    rays = sight_rays(camera)
    if rays is None:
        return Surface(maps, partial(mesh_from_point_map, maps.point_mm, maps.normal, valid), (NO_CAMERA,))
    centre, direction = rays
    depth = ((maps.point_mm - centre) * direction).sum(axis=2)
    surface = integrate_perspective(
        maps.normal,
        valid,
        centre_mm=centre,
        direction=direction,
        anchor_depth_mm=depth,
        integration="discrete",
    )
    return Surface(maps, partial(mesh_from_point_map, surface.point_mm, maps.normal, valid))


def _fused_apart(
    maps: Maps, crossing: Crossing, apart: Mask | None, *, n_liquid: float, n_air: float, threads: int = 1
) -> Maps:
    """Fuse all pixels, and the others without those that are ``apart``, which lean on them but must not pull them."""
    whole = fused_surface(maps, crossing, n_liquid=n_liquid, n_air=n_air, threads=threads)
    if apart is None or not apart.any():
        return whole
    there = apart.ravel()[crossing.pixels]
    others = replace(crossing, status=np.where(there, np.uint8(PixelStatus.MASKED_OUT), crossing.status))
    rest = fused_surface(maps, others, n_liquid=n_liquid, n_air=n_air, threads=threads)
    names = ("point_mm", "normal", "sd_mm", "status", "normal_sd_rad", "across_sd_mm", "support")
    joined = {}
    for name in names:
        inside, outside = getattr(whole, name), getattr(rest, name)
        joined[name] = np.where(apart if inside.ndim == 2 else apart[..., None], inside, outside)
    return replace(maps, **joined)


def fused_surface(maps: Maps, crossing: Crossing, *, n_liquid: float, n_air: float, threads: int = 1) -> Maps:
    """Fuse positions and normals on the paths in liquid, then refine points and normals where their neighbours allow it.

    Pixels with parallel paths get their point from their neighbours. All of it happens in the part of the photo that holds the
    surface.
    """
    inner = crossing.on_surface()
    shape = (maps.status.shape[0], maps.status.shape[1])
    window = PhotoWindow.about(inner.pixels, shape, margin_px=MARGIN_PX)
    found = _fused(
        replace(inner, pixels=window.numbers(inner.pixels)),
        window.shape,
        n_liquid=n_liquid,
        n_air=n_air,
        threads=threads,
    )
    status = maps.status.copy()
    surface = status[window.part]
    lost = (surface == PixelStatus.OK) & ~found.covered
    surface[found.covered] = PixelStatus.OK
    surface[lost] = np.where(found.outlier[lost], PixelStatus.STANDS_ALONE, PixelStatus.PARALLEL_PATHS)

    def on_photo(values: np.ndarray, dtype: type, nothing: float = np.nan) -> np.ndarray:
        return window.on_photo(values.astype(dtype, copy=False), shape[0], nothing=nothing)

    return replace(
        maps,
        point_mm=on_photo(found.point_mm, np.float64),
        normal=on_photo(found.normal, np.float64),
        sd_mm=on_photo(found.sd_mm, np.float32),
        status=status,
        normal_sd_rad=on_photo(found.normal_sd_rad, np.float32),
        across_sd_mm=on_photo(found.across_sd_mm, np.float32),
        support=on_photo(found.support, np.uint8, float(Support.NONE)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Fused:
    """What was found in a window: NaN where nothing is ``covered``; ``outlier`` pixels agree with none about them."""

    point_mm: np.ndarray
    normal: np.ndarray
    sd_mm: np.ndarray
    normal_sd_rad: np.ndarray
    across_sd_mm: np.ndarray
    support: np.ndarray
    covered: np.ndarray
    outlier: np.ndarray


def _fused(crossing: Crossing, shape: tuple[int, int], *, n_liquid: float, n_air: float, threads: int) -> _Fused:
    """Fuse the crossings, all of which are of the surface.

    A pixel's path is the mean over its footprint. Liquid bends light less than air at the same surface, so its mean path runs
    closer to the path of the pixel's centre, above all near total reflection.
    """
    everywhere = np.ones(len(crossing.pixels), dtype=bool)
    has_point = crossing.status == PixelStatus.OK
    liquid, points = crossing.liquid, crossing.points
    along_sd = np.sqrt(np.einsum("pi,pij,pj->p", liquid.direction, points.covariance, liquid.direction))
    paths = PathMeasurement.of(crossing, everywhere, shape=shape, n_liquid=n_liquid, n_air=n_air, threads=threads)
    on_grid = paths.on_grid
    direction, normal_sd_rad, *measured = side_by_side(
        partial(on_grid, liquid.direction, everywhere),
        partial(on_grid, crossing.normal_sd_rad, everywhere),
        partial(on_grid, liquid.near_mm, everywhere),
        partial(on_grid, points.distance_liquid_mm, has_point),
        partial(on_grid, along_sd, has_point),
        threads=threads,
    )
    normal = paths.normal_map
    # Handed over and not kept: fusion lets them go before it draws errors.
    fused = fuse_on_rays(
        measured.pop(0),
        direction,
        measured.pop(0),
        measured.pop(0),
        normal,
        normal_sd_rad,
        np.isfinite(normal).all(axis=2),
        remeasure=paths.remeasure,
        noise=paths.noise_at,
        threads=threads,
    )
    give_back_free_memory()
    distance = np.nan_to_num(fused.distance_mm.ravel()[crossing.pixels])
    refined = refine_surface(
        fused,
        direction,
        normal,
        normal_sd_rad,
        on_grid(liquid.covariance_at(distance), everywhere),
        threads=threads,
    )
    covered = np.isfinite(refined.point_mm).all(axis=2) & ~fused.outlier
    for values in (refined.point_mm, refined.normal, refined.sd_mm, refined.normal_sd_rad, refined.across_sd_mm):
        values[~covered] = np.nan
    # What all pixels share does not go away by asking neighbours.
    carried_mm2, carried_rad2 = (
        on_grid(shared, everywhere) for shared in (crossing.carried_mm2, crossing.carried_rad2)
    )
    support = np.where(np.isfinite(on_grid(along_sd, has_point)), Support.OWN_CROSSING, Support.NEIGHBOURS_ONLY)
    return _Fused(
        point_mm=refined.point_mm,
        normal=refined.normal,
        sd_mm=np.sqrt(refined.sd_mm**2 + carried_mm2),
        normal_sd_rad=np.sqrt(refined.normal_sd_rad**2 + carried_rad2),
        across_sd_mm=refined.across_sd_mm,
        support=np.where(covered, support, Support.NONE),
        covered=covered,
        outlier=fused.outlier,
    )
