"""Surfaces known in closed form and the light paths that meet them, for the tests of fusion and refinement."""

from dataclasses import dataclass

import numpy as np

from recon.surface.fusion import FusedSurface, fuse_on_rays

RADIUS_MM = 28.0
DISTANCE_MM = 60.0


@dataclass
class Scene:
    """A surface met by converging rays, ``DISTANCE_MM`` from their origins."""

    point: np.ndarray
    normal: np.ndarray
    direction: np.ndarray
    mask: np.ndarray

    @property
    def origin(self) -> np.ndarray:
        return self.point - DISTANCE_MM * self.direction

    def fuse(self, distance: np.ndarray, sd: float, normal: np.ndarray, normal_sd: float, **more: int) -> FusedSurface:
        ones = np.ones(self.mask.shape)
        return fuse_on_rays(
            self.origin, self.direction, distance, sd * ones, normal, normal_sd * ones, self.mask, **more
        )

    def noisy(self, seed: int, sd: float, normal_sd: float) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        tilt = rng.standard_normal(self.point.shape) * normal_sd / np.sqrt(2)
        normal = self.normal + tilt - (tilt * self.normal).sum(2, keepdims=True) * self.normal
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        return DISTANCE_MM + sd * rng.standard_normal(self.mask.shape), normal


def converging(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    direction = np.stack([-0.02 * x, -0.015 * y + 0.1, -np.ones_like(x)], axis=2)
    return direction / np.linalg.norm(direction, axis=2, keepdims=True)


def sphere(size: int = 41) -> Scene:
    axis = np.linspace(-22, 22, size)
    x, y = np.meshgrid(axis, axis)
    mask = x**2 + y**2 < 21.5**2
    z = np.sqrt(np.where(mask, RADIUS_MM**2 - x**2 - y**2, np.nan))
    point = np.stack([x, y, z], axis=2)
    return Scene(point, point / RADIUS_MM, converging(x, y), mask)


def plane(size: int = 20, slope: float = 0.0) -> Scene:
    axis = np.linspace(-10, 10, size)
    x, y = np.meshgrid(axis, axis)
    point = np.stack([x, y, slope * x], axis=2)
    normal = np.broadcast_to(np.array([-slope, 0, 1]) / np.hypot(slope, 1), point.shape).copy()
    return Scene(point, normal, np.broadcast_to([0.0, 0.0, -1.0], point.shape).copy(), np.ones(x.shape, bool))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
