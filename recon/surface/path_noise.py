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
    near, far = paths.near_noise.drawn(rng), paths.far_noise.drawn(rng)
    slope = (near - far) / paths.baseline_mm[:, None]
    turn = slope - (slope * paths.direction).sum(axis=1, keepdims=True) * paths.direction
    return near + distance_mm[:, None] * slope, turn
