"""From the correspondences of four sets to points and normals on the camera grid: pure arrays, no files."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from recon.bands import over_bands, side_by_side
from recon.geometry.beside import liquid_surface
from recon.geometry.crossing_tests import crossing_tests
from recon.geometry.entry_point import EntryPoints, entry_points
from recon.geometry.light_paths import LightPaths, light_paths
from recon.geometry.normals import normal_sd_rad, normals_from_angles, normals_from_paths
from recon.maps import Maps
from recon.method import Limits, Method
from recon.sessions.manifest import CaptureSet, Manifest
from recon.status import PixelStatus
from recon.sweeps.set_places import (
    Correspondences,
    SweepResults,
    combined_status,
    correspondences,
    second_correspondences,
)

# The scatter of the parabola's vertex for a sharp stripe, in steps: its bias changes from pixel to pixel.
PARABOLA_SD_PX = 0.17
# In which media a pixel that sees the display twice may be read by the path with less light; first: in none.
CHOICES: tuple[tuple[str, ...], ...] = ((), ("air",), ("liquid",), ("air", "liquid"))
CROSSING_VECTORS = ("pixels", "normal", "normal_sd_rad", "carried_mm2", "carried_rad2", "status")


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """All that is known of the pixels listed in ``pixels`` before they become maps.

    ``carried_mm2`` and ``carried_rad2`` are the variances of point and normal that all pixels share, since they stem from the
    poses and not from each pixel's own noise: neighbours cannot average them out.
    """

    pixels: np.ndarray
    liquid: LightPaths
    air: LightPaths
    points: EntryPoints
    normal: np.ndarray
    normal_sd_rad: np.ndarray
    carried_mm2: np.ndarray
    carried_rad2: np.ndarray
    status: np.ndarray  # of the listed pixels

    def some(self, rows: np.ndarray) -> "Crossing":
        """Return some rows of the list."""
        vectors = {name: getattr(self, name)[rows] for name in CROSSING_VECTORS}
        return Crossing(
            liquid=self.liquid.some(rows), air=self.air.some(rows), points=self.points.some(rows), **vectors
        )

    def on_surface(self) -> "Crossing":
        """Return the pixels that have a normal of the object, and mostly a point; itself where they are all."""
        surface_pixel = np.isin(self.status, (PixelStatus.OK, PixelStatus.PARALLEL_PATHS))
        return self if surface_pixel.all() else self.some(surface_pixel)


def cross_paths(
    sweeps: SweepResults,
    manifest: Manifest,
    *,
    method: Method,
    limits: Limits,
    inside_mask: np.ndarray | None = None,
    threads: int = 1,
) -> tuple[UInt8[np.ndarray, " pixels"], Crossing]:
    """Cross the paths in liquid and in air of every matched pixel; return the status of all pixels and the crossings.

    So many ``threads`` share the pixels.
    """
    status = combined_status(sweeps, manifest.sets)
    if inside_mask is not None:
        status[~inside_mask.ravel() & (status != PixelStatus.UNLIT)] = PixelStatus.MASKED_OUT
    twice = np.flatnonzero(status == PixelStatus.TWO_PATHS)
    choice = _choices(sweeps, twice, manifest, method=method, limits=limits)
    status[twice[choice >= 0]] = PixelStatus.OK
    pixels = np.flatnonzero(status == PixelStatus.OK)

    def places_of(one: CaptureSet) -> Correspondences:
        found = correspondences(sweeps, one, manifest, pixels)
        by_lesser = twice[np.isin(choice, [k for k, media in enumerate(CHOICES) if one.condition in media])]
        if not len(by_lesser):
            return found
        lesser = second_correspondences(sweeps, one, manifest, by_lesser)
        return found.with_rows_of(lesser, np.searchsorted(pixels, by_lesser))

    with ThreadPoolExecutor(threads) as pool:
        by_name = dict(zip((one.name for one in manifest.sets), pool.map(places_of, manifest.sets), strict=True))
    paths, points = _crossed(by_name, manifest, method=method, threads=threads)
    route = normals_from_angles if method == "paper" else normals_from_paths
    media = {"n_liquid": manifest.n_liquid(), "n_air": manifest.n_air}
    normal, normal_sd = np.empty((len(pixels), 3)), np.empty(len(pixels))

    def find_normals(band: slice) -> None:
        liquid, air = (paths[condition].some(band) for condition in ("liquid", "air"))
        normal[band] = route(liquid.direction, air.direction, **media)
        normal_sd[band] = normal_sd_rad(liquid, air, **media)

    over_bands(find_normals, len(pixels), threads=threads)
    crossing = Crossing(
        pixels=pixels,
        liquid=paths["liquid"],
        air=paths["air"],
        points=points,
        normal=normal,
        normal_sd_rad=normal_sd,
        carried_mm2=np.zeros(len(pixels)),
        carried_rad2=np.zeros(len(pixels)),
        status=crossing_tests(points, manifest, method=method, limits=limits),
    )
    beside = liquid_surface(
        points,
        paths["liquid"],
        paths["air"],
        normal,
        manifest,
        direction_sd_rad=_direction_sd(paths["air"], manifest, method=method),
        pixels=pixels,
        shape=(manifest.camera.rows, manifest.camera.columns),
        threads=threads,
    )
    crossing.status[beside] = PixelStatus.BESIDE_OBJECT
    status[pixels] = crossing.status
    return status, crossing


def without_spots(
    status: UInt8[np.ndarray, " pixels"], crossing: Crossing, spots: Bool[np.ndarray, "rows cols"]
) -> tuple[UInt8[np.ndarray, " pixels"], Crossing]:
    """Leave out the pixels of spots, whose paths in the liquid may be wrong where their gaps do not show it."""
    on_surface = np.isin(crossing.status, (PixelStatus.OK, PixelStatus.PARALLEL_PATHS))
    lost = spots.ravel()[crossing.pixels] & on_surface
    ours = np.where(lost, np.uint8(PixelStatus.WET_SPOT), crossing.status)
    everywhere = status.copy()
    everywhere[crossing.pixels] = ours
    return everywhere, replace(crossing, status=ours)


def _choices(
    sweeps: SweepResults, twice: np.ndarray, manifest: Manifest, *, method: Method, limits: Limits
) -> Int64[np.ndarray, " twice"]:
    """Return for each pixel in ``twice`` which of ``CHOICES`` says what paths in liquid and air belong together; −1: not known.

    The paths with more light do if they meet as well as their noise lets them; where they do not, the one other pair that does.
    """
    if not len(twice):
        return np.empty(0, dtype=np.int64)
    first, lesser = (
        {one.name: joined(sweeps, one, manifest, twice) for one in manifest.sets}
        for joined in (correspondences, second_correspondences)
    )
    doubled = {
        condition: np.any([first[one.name].doubled for one in manifest.sets if one.condition == condition], axis=0)
        for condition in ("air", "liquid")
    }
    met = []
    for choice in CHOICES:
        chosen = {one.name: (lesser if one.condition in choice else first)[one.name] for one in manifest.sets}
        _, points = _crossed(chosen, manifest, method=method)
        tests = crossing_tests(points, manifest, method=method, limits=limits)
        meets = (tests == PixelStatus.OK) | ((tests == PixelStatus.PARALLEL_PATHS) & (not choice))
        met.append(np.logical_and.reduce([meets, *(doubled[condition] for condition in choice)]))
    found = np.stack(met)
    return np.where(found[0], 0, np.where(found[1:].sum(axis=0) == 1, 1 + found[1:].argmax(axis=0), -1))


def _crossed(
    by_name: Mapping[str, Correspondences], manifest: Manifest, *, method: Method, threads: int = 1
) -> tuple[dict[str, LightPaths], EntryPoints]:
    """Make the paths in liquid and in air, and cross them."""
    make = partial(paths_of, by_name, manifest, method=method)
    liquid, air = side_by_side(
        partial(make, "liquid", n_medium=manifest.n_liquid()),
        partial(make, "air", n_medium=manifest.n_air),
        threads=threads,
    )
    paths = {"liquid": liquid, "air": air}
    return paths, entry_points(paths["liquid"], paths["air"], weighted=method == "full", threads=threads)


def paths_of(
    by_name: Mapping[str, Correspondences],
    manifest: Manifest,
    condition: str,
    *,
    n_medium: float,
    method: Method,
) -> LightPaths:
    """Make the paths of these pixels in one medium from the correspondences of its two sets."""
    first, second = (by_name[f"pos{position}_{condition}"] for position in (0, 1))
    sets = [manifest.set_named(f"pos{position}_{condition}") for position in (0, 1)]
    # The paper's method knows no uncertainty; equal ones make its crossing the plain middle.
    unknown = np.zeros_like(first.sd_mm)
    return light_paths(
        (first.screen_mm, second.screen_mm),
        (unknown, unknown) if method == "paper" else (first.sd_mm, second.sd_mm),
        (manifest.pose_of(sets[0]), manifest.pose_of(sets[1])),
        cover_glass=manifest.display.cover_glass,
        n_medium=n_medium,
    )


def _direction_sd(air: LightPaths, manifest: Manifest, *, method: Method) -> Float64[np.ndarray, " pixels"]:
    """Return how well each air path's direction is known; for the paper's method, from its usual scatter."""
    if method == "paper":
        return np.sqrt(2) * PARABOLA_SD_PX * manifest.display.pitch_mm / air.baseline_mm
    return np.sqrt(air.direction_variance())


def maps_of(status: np.ndarray, crossing: Crossing, *, shape: tuple[int, int], method: Method) -> Maps:
    """Lay the crossings out on the camera grid; only pixels whose status is OK get a point and a normal."""
    fine = crossing.status == PixelStatus.OK
    points = crossing.points
    sd = np.sqrt(np.trace(points.covariance, axis1=1, axis2=2) + crossing.carried_mm2)
    if method == "paper":
        sd = np.full_like(sd, np.nan)
    return replace(
        maps_before_surface(status, crossing, shape=shape),
        point_mm=_spread(points.point_mm, crossing.pixels, fine, shape, np.float64),
        normal=_spread(crossing.normal, crossing.pixels, fine, shape, np.float64),
        sd_mm=_spread(sd, crossing.pixels, fine, shape, np.float32),
    )


def maps_before_surface(status: np.ndarray, crossing: Crossing, *, shape: tuple[int, int]) -> Maps:
    """Lay out gaps, angles and statuses alone; points, normals and their sds are left to a surface, and take no memory."""
    everywhere = np.ones(len(crossing.pixels), dtype=bool)
    gap_mm, angle_rad = (
        _spread(values, crossing.pixels, everywhere, shape, np.float32)
        for values in (crossing.points.gap_mm, crossing.points.angle_rad)
    )
    nowhere = np.broadcast_to(np.nan, (*shape, 3))
    return Maps(
        point_mm=nowhere,
        normal=nowhere,
        sd_mm=np.broadcast_to(np.float32(np.nan), shape),
        gap_mm=gap_mm,
        pbc_angle_rad=angle_rad,
        status=status.astype(np.uint8).reshape(shape),
    )


def _spread(
    values: np.ndarray, pixels: np.ndarray, where: np.ndarray, shape: tuple[int, int], dtype: type
) -> np.ndarray:
    whole = np.full((shape[0] * shape[1], *values.shape[1:]), np.nan, dtype=dtype)
    whole[pixels[where]] = values[where]
    return whole.reshape(*shape, *values.shape[1:])
