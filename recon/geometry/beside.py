"""Tell the object from what lies beside it: pixels that look past the object at the liquid's own flat surface.

Two facts mark such a pixel. With the tank dry nothing bends its light, so its path in air is the camera's own straight
ray; and its crossing with the path in liquid lies on one plane, the liquid's level, upright to it. A pixel of the object
may show either by chance (a ray through its very middle is not bent); a neighbourhood shows both only beside the object.

Light that left the object above the liquid meets the level as well: bent before, it still crosses there, upright to the plane.
Once the level is known, regions of such crossings are told by that alone.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import label, maximum_filter, median, uniform_filter

from recon.geometry.entry_point import EntryPoints
from recon.geometry.light_paths import LightPaths
from recon.media.index_estimate import robust_weights, variance_by_bands
from recon.sessions.manifest import Manifest

# How far an unbent ray may seem to miss the camera: calibration errors of a tenth of a degree are ordinary.
STRAIGHT_RAD = np.radians(0.1)
# A stray path may miss by anything; held to this it does not spoil its neighbourhood's mean.
STRAY_RAD = np.radians(2.0)
NEIGHBOURHOOD_PX = 7
ALIGNED_RAD = np.radians(5.0)
SIGMA = 5.0
DIRECTION_SIGMA = 2.0
# A face of the object just below the level lies on one side of it; crossings on the level scatter about it.
REGION_SIGMA = 1.0
ROUNDING_MM = 1e-9
LEVEL_ROUNDS = 8
# Errors are alike along bands of rows and of columns, which see the same pixels of the display.
BAND_PX = 16
FEWEST_PIXELS = 100
# The level is a plane if most of the candidates say so.
PLANE_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LiquidLevel:
    """The flat surface of the liquid: a point on it, its upright unit vector, how points scatter about it, and its own sd."""

    centre_mm: Float64[np.ndarray, " 3"]
    upright: Float64[np.ndarray, " 3"]
    scatter_mm: float
    sd_mm: float


def liquid_surface(
    points: EntryPoints,
    liquid: LightPaths,
    air: LightPaths,
    normal: Float64[np.ndarray, "pixels 3"],
    manifest: Manifest,
    *,
    direction_sd_rad: Float64[np.ndarray, " pixels"],
    pixels: np.ndarray,
    shape: tuple[int, int],
    threads: int = 1,
) -> Bool[np.ndarray, " pixels"]:
    """Return which of the listed ``pixels`` (flat indices into ``shape``) see the liquid's level and no surface of the object.

    ``direction_sd_rad`` is how well each air path's direction is known; where pixels are finer than the display's, neighbours
    err alike, so a neighbourhood is known no better than one pixel.

    None do where the camera's place is not known: then its straight rays are not known either.
    """
    if manifest.camera.pose is None or len(pixels) == 0:
        return np.zeros(len(pixels), dtype=bool)
    camera_mm = np.array(manifest.camera.pose.centre_mm)
    straight = straight_paths(air, camera_mm, direction_sd_rad, pixels=pixels, shape=shape, threads=threads)
    place = np.column_stack(np.divmod(pixels, shape[1])).astype(np.float64)
    level = _level(points, (liquid, air), normal, straight, place=place)
    if level is None:
        return np.zeros(len(pixels), dtype=bool)
    height = (points.point_mm - level.centre_mm) @ level.upright
    sd = np.sqrt(np.einsum("i,pij,j->p", level.upright, points.covariance, level.upright))
    with np.errstate(invalid="ignore"):
        on_level = np.abs(height) <= SIGMA * np.maximum(sd, level.scatter_mm)
        aligned = np.abs(normal @ level.upright) > np.cos(ALIGNED_RAD)
        own_mm = np.hypot(np.where(sd > 0, sd, level.scatter_mm), level.sd_mm)
        in_sd = height / np.maximum(own_mm, ROUNDING_MM)
    past = straight & on_level & aligned
    past &= _in_level_regions(past, in_sd, pixels=pixels, shape=shape)
    bent = on_level & aligned & ~past
    seen = past | (bent & _in_level_regions(bent, in_sd, pixels=pixels, shape=shape))
    # Along the object's outline photos are compressed with errors of their own, which lift a crossing far off the level; a curve
    # is drawn by up to half a device pixel there, one way at one position of the display and the other way at the other.
    drawn_rad = manifest.display.pitch_mm / air.baseline_mm
    unbent = np.linalg.norm(_miss(air, camera_mm), axis=1) <= np.maximum(
        np.maximum(STRAIGHT_RAD, drawn_rad), DIRECTION_SIGMA * direction_sd_rad
    )
    return seen | (unbent & aligned & _beside(past, pixels=pixels, shape=shape))


def _beside(
    found: Bool[np.ndarray, " pixels"], *, pixels: np.ndarray, shape: tuple[int, int]
) -> Bool[np.ndarray, " pixels"]:
    """Tell which pixels have one of ``found`` in their neighbourhood."""
    grid = np.zeros(shape, dtype=bool)
    grid.ravel()[pixels[found]] = True
    return maximum_filter(grid, NEIGHBOURHOOD_PX).ravel()[pixels]


def _in_level_regions(
    found: Bool[np.ndarray, " pixels"],
    height_in_sd: Float64[np.ndarray, " pixels"],
    *,
    pixels: np.ndarray,
    shape: tuple[int, int],
) -> Bool[np.ndarray, " pixels"]:
    """Tell which pixels lie in regions of ``found`` larger than a neighbourhood, whose heights scatter about the level."""
    grid = np.zeros(shape, dtype=bool)
    grid.ravel()[pixels[found]] = True
    regions, count = label(grid)
    of_pixel = regions.ravel()[pixels]
    about = np.bincount(of_pixel[found], minlength=count + 1) > NEIGHBOURHOOD_PX**2
    about[0] = False
    numbers = np.flatnonzero(about)
    if len(numbers):
        about[numbers] = np.abs(median(height_in_sd[found], of_pixel[found], numbers)) <= REGION_SIGMA
    return about[of_pixel]


def straight_paths(
    air: LightPaths,
    camera_mm: Float64[np.ndarray, " 3"],
    direction_sd_rad: Float64[np.ndarray, " pixels"],
    *,
    pixels: np.ndarray,
    shape: tuple[int, int],
    threads: int = 1,
) -> Bool[np.ndarray, " pixels"]:
    """Return which air paths run through the camera's centre, as unbent rays do, taken over a neighbourhood.

    ``pixels`` are the flat indices into ``shape`` of the paths. So many ``threads`` share the sums over neighbourhoods.
    """
    miss = _miss(air, camera_mm)
    size = np.linalg.norm(miss, axis=1, keepdims=True)
    miss *= np.minimum(1.0, STRAY_RAD / np.maximum(size, 1e-12))
    layers = (*miss.T, np.minimum(direction_sd_rad, STRAY_RAD), np.ones(len(miss)))

    def near(layer: np.ndarray) -> np.ndarray:
        grid = np.zeros(shape)
        grid.ravel()[pixels] = layer
        return uniform_filter(grid, NEIGHBOURHOOD_PX, mode="constant").ravel()[pixels]

    with ThreadPoolExecutor(threads) as pool:
        *sums, count = pool.map(near, layers)
    x, y, z, sd = (one / count for one in sums)
    return np.sqrt(x**2 + y**2 + z**2) <= np.maximum(STRAIGHT_RAD, DIRECTION_SIGMA * sd)


def _miss(air: LightPaths, camera_mm: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, "pixels 3"]:
    """Return by how much each path misses the camera's centre, seen from the display, in rad."""
    to_camera = camera_mm - air.near_mm
    along = (to_camera * air.direction).sum(axis=1, keepdims=True)
    return (to_camera - along * air.direction) / np.linalg.norm(to_camera, axis=1, keepdims=True)


def _level(
    points: EntryPoints,
    paths: tuple[LightPaths, LightPaths],
    normal: np.ndarray,
    straight: np.ndarray,
    *,
    place: Float64[np.ndarray, "pixels 2"],
) -> LiquidLevel | None:
    """Return the plane on which most of the straight pixels' crossings lie, if there is one.

    Its upright is the median of their normals, which hardly depend on where the crossings are.
    """
    known = straight & np.isfinite(points.point_mm).all(axis=1) & np.isfinite(normal).all(axis=1)
    if np.count_nonzero(known) < FEWEST_PIXELS:
        return None
    upright = np.median(normal[known], axis=0)
    upright /= np.linalg.norm(upright)
    middle, middle_sd = _level_height(paths, upright, known, place=place[known])
    height = points.point_mm[known] @ upright - middle
    variance = np.einsum("i,pij,j->p", upright, points.covariance[known], upright)
    weight = 1 / np.maximum(variance, 1e-3 * np.median(variance)) if variance.any() else np.ones(len(height))
    scatter = 1.4826 * _weighted_median(np.abs(height), weight)
    on_level = np.abs(height) <= SIGMA * np.maximum(np.sqrt(variance), scatter)
    if on_level.mean() < PLANE_SHARE:
        return None
    return LiquidLevel(middle * upright, upright, scatter, middle_sd)


def _level_height(
    paths: tuple[LightPaths, LightPaths],
    upright: Float64[np.ndarray, " 3"],
    known: Bool[np.ndarray, " pixels"],
    *,
    place: Float64[np.ndarray, "known 2"],
) -> tuple[float, float]:
    """Return the height along ``upright`` at which the two paths of all known pixels meet, and its standard deviation.

    At a height L the paths are D₀ + L D₁ apart. Noise in D₁ would draw L towards where the display stands; so the equations are
    weighted by D₁ as an affine function of the pixel's place (row, column), which has next to none (instrumental variables).
    """
    at_zero, slope = [], []
    for one in paths:
        climb = one.direction[known] / (one.direction[known] @ upright)[:, None]
        near = one.near_mm[known]
        at_zero.append(near - (near @ upright)[:, None] * climb)
        slope.append(climb)
    apart, parting = at_zero[0] - at_zero[1], slope[0] - slope[1]
    affine = np.column_stack([np.ones(len(place)), place])
    smooth = affine @ np.linalg.lstsq(affine, parting, rcond=None)[0]
    weight = np.ones(len(place))
    for _ in range(LEVEL_ROUNDS):
        each = weight[:, None] * smooth
        level = -(each * apart).sum() / (each * parting).sum()
        weight = robust_weights(np.linalg.norm(apart + level * parting, axis=1))
    row, column = np.repeat(place // BAND_PX, 3, axis=0).astype(np.int64).T
    variance = variance_by_bands(
        parting.reshape(-1, 1), each.reshape(-1, 1), (apart + level * parting).ravel(), row=row, column=column
    )
    return float(level), float(np.sqrt(variance))


def _weighted_median(values: np.ndarray, weight: np.ndarray) -> float:
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(share, 0.5 * share[-1])]])
