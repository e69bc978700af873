"""Tell the object from what lies beside it: pixels that look past the object at the liquid's own flat surface.

Two facts mark such a pixel. With the tank dry nothing bends its light, so its path in air is the camera's own straight
ray; and its crossing with the path in liquid lies on one plane, the liquid's level, upright to it. A pixel of the object
may show either by chance (a ray through its very middle is not bent); a neighbourhood shows both only beside the object.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import label

from recon.entry_point import EntryPoints
from recon.light_paths import LightPaths
from recon.manifest import Manifest

# How far an unbent ray may seem to miss the camera: calibration errors of a tenth of a degree are ordinary.
STRAIGHT_RAD = np.radians(0.1)
# A pixel's own noise can exceed that; its neighbourhood's mean does not, once strays are held to this.
STRAY_RAD = np.radians(2.0)
NEIGHBOURHOOD_PX = 7
ALIGNED_RAD = np.radians(5.0)
SIGMA = 5.0
FEWEST_PIXELS = 100
# The level is a plane if most of the candidates say so.
PLANE_SHARE = 0.5
ROUNDS = 10


@dataclass(frozen=True, slots=True, eq=False)
class LiquidLevel:
    """The flat surface of the liquid: a point on it, its upright unit vector and the scatter of points about it, mm."""

    centre_mm: Float64[np.ndarray, " 3"]
    upright: Float64[np.ndarray, " 3"]
    scatter_mm: float


def liquid_surface(
    points: EntryPoints,
    air: LightPaths,
    normal: Float64[np.ndarray, "pixels 3"],
    manifest: Manifest,
    *,
    pixels: np.ndarray,
    shape: tuple[int, int],
) -> Bool[np.ndarray, " pixels"]:
    """Return which of the listed ``pixels`` (flat indices into ``shape``) look past the object.

    None do where the camera's place is not known: then its straight rays are not known either.
    """
    if manifest.camera.pose is None or len(pixels) == 0:
        return np.zeros(len(pixels), dtype=bool)
    straight = _straight(air, np.array(manifest.camera.pose.centre_mm), pixels=pixels, shape=shape)
    level = _level(points, straight)
    if level is None:
        return np.zeros(len(pixels), dtype=bool)
    height = (points.point_mm - level.centre_mm) @ level.upright
    sd = np.sqrt(np.einsum("i,pij,j->p", level.upright, points.covariance, level.upright))
    with np.errstate(invalid="ignore"):
        on_level = np.abs(height) <= SIGMA * np.maximum(sd, level.scatter_mm)
        aligned = np.abs(normal @ level.upright) > np.cos(ALIGNED_RAD)
    return _in_regions(straight & on_level & aligned, pixels=pixels, shape=shape)


def _in_regions(found: np.ndarray, *, pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Keep what lies in connected regions larger than a neighbourhood."""
    grid = np.zeros(shape, dtype=bool)
    grid.ravel()[pixels[found]] = True
    regions, _ = label(grid)
    size = np.bincount(regions.ravel())
    size[0] = 0
    return found & (size[regions.ravel()[pixels]] > NEIGHBOURHOOD_PX**2)


def _straight(air: LightPaths, camera_mm: np.ndarray, *, pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return which air paths run through the camera's centre, as unbent rays do, taken over a neighbourhood."""
    to_camera = camera_mm - air.near_mm
    along = (to_camera * air.direction).sum(axis=1, keepdims=True)
    miss = (to_camera - along * air.direction) / np.linalg.norm(to_camera, axis=1, keepdims=True)
    size = np.linalg.norm(miss, axis=1, keepdims=True)
    miss *= np.minimum(1.0, STRAY_RAD / np.maximum(size, 1e-12))
    total = np.zeros((*shape, 4))
    total.reshape(-1, 4)[pixels] = np.concatenate([miss, np.ones((len(miss), 1))], axis=1)
    window = (NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX)
    total = cv2.boxFilter(total, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    mean = total.reshape(-1, 4)[pixels]
    return np.linalg.norm(mean[:, :3], axis=1) <= STRAIGHT_RAD * mean[:, 3]


def _level(points: EntryPoints, straight: np.ndarray) -> LiquidLevel | None:
    """Return the plane on which most of the straight pixels' crossings lie, if there is one."""
    candidates = points.point_mm[straight & np.isfinite(points.point_mm).all(axis=1)]
    if len(candidates) < FEWEST_PIXELS:
        return None
    kept = np.ones(len(candidates), dtype=bool)
    for _ in range(ROUNDS):
        centre = np.median(candidates[kept], axis=0)
        spread = candidates[kept] - centre
        upright = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        height = (candidates - centre) @ upright
        middle = float(np.median(height[kept]))
        centre, height = centre + middle * upright, height - middle
        scatter = 1.4826 * float(np.median(np.abs(height[kept])))
        kept = np.abs(height) <= max(SIGMA * scatter, 1e-9)
        if np.count_nonzero(kept) < FEWEST_PIXELS:
            return None
    if kept.mean() < PLANE_SHARE:
        return None
    return LiquidLevel(centre, upright, scatter)
