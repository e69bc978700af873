"""What the noise of the correspondences does to a pixel's distance and normal, drawn at random, to first order."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.geometry.light_paths import LightPaths

Vectors = Float64[np.ndarray, "pixels 3"]
PerPath = Float64[np.ndarray, " pixels"]


@dataclass(frozen=True, slots=True, eq=False)
class PathNoise:
    """Two paths a pixel with the noise of their display points, and the normal that is made of them."""

    liquid: LightPaths
    air: LightPaths
    normal: Vectors
    n_liquid: float
    n_air: float

    def draw(
        self, rng: np.random.Generator, *, along_liquid_mm: PerPath, along_air_mm: PerPath
    ) -> tuple[Vectors, Vectors, Vectors]:
        """Draw one shift of the liquid path and of the air path, at these distances along them, and one error of the normal.

        All come from the same eight numbers.
        """
        u, v = self.liquid.direction, self.air.direction
        shift_liquid, turn_liquid = _path_error(self.liquid, along_liquid_mm, rng)
        shift_air, turn_air = _path_error(self.air, along_air_mm, rng)
        along = self.n_liquid * u - self.n_air * v
        # The normal is ± this difference over its length; only what is at right angles to it turns it.
        signed_length = (along * self.normal).sum(axis=1, keepdims=True)
        change = (self.n_liquid * turn_liquid - self.n_air * turn_air) / signed_length
        return shift_liquid, shift_air, change - (change * self.normal).sum(axis=1, keepdims=True) * self.normal


def _path_error(
    paths: LightPaths, distance_mm: Float64[np.ndarray, " pixels"], rng: np.random.Generator
) -> tuple[Vectors, Vectors]:
    """Draw by how much each path is shifted at a distance, and by how much its direction turns."""
    near, far = (_drawn(covariance, rng) for covariance in (paths.near_covariance, paths.far_covariance))
    slope = (near - far) / paths.baseline_mm[:, None]
    turn = slope - (slope * paths.direction).sum(axis=1, keepdims=True) * paths.direction
    return near + distance_mm[:, None] * slope, turn


def _drawn(covariance: Float64[np.ndarray, "pixels 3 3"], rng: np.random.Generator) -> Vectors:
    """Draw one vector a pixel with this covariance, by Cholesky's factor, which may have zero pivots."""
    z = rng.standard_normal((len(covariance), 3))
    c = covariance
    first = np.sqrt(np.maximum(c[:, 0, 0], 0.0))
    second_first, third_first = _ratio(c[:, 1, 0], first), _ratio(c[:, 2, 0], first)
    second = np.sqrt(np.maximum(c[:, 1, 1] - second_first**2, 0.0))
    third_second = _ratio(c[:, 2, 1] - second_first * third_first, second)
    third = np.sqrt(np.maximum(c[:, 2, 2] - third_first**2 - third_second**2, 0.0))
    return np.stack(
        [
            first * z[:, 0],
            second_first * z[:, 0] + second * z[:, 1],
            third_first * z[:, 0] + third_second * z[:, 1] + third * z[:, 2],
        ],
        axis=1,
    )


def _ratio(value: np.ndarray, pivot: np.ndarray) -> np.ndarray:
    return np.divide(value, pivot, out=np.zeros_like(value), where=pivot > 0)
