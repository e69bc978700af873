"""The crossing of two light paths as a measurement of the distance along one of them, weighed without favour.

A pixel whose angle between the paths came out too large by noise has its crossing too near, and by its own numbers it is
surer than the others: weighed by them, a mean is biased. So each crossing is read near a surface that is roughly known, with
the angle that the pixels about it have on average.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from recon.geometry.entry_point import EntryPoints
from recon.geometry.light_paths import LightPaths

PerPath = Float64[np.ndarray, " pixels"]

# So many pixels across are averaged for an angle, noise of which is then a ninth.
ANGLE_WINDOW_PX = 9
# A mean counts where it is neither less than this share of the pixel's own nor more than its inverse.
LEAST_ALIKE = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class PathCrossing:
    """Two paths for each of some pixels of the camera's grid, with the mean of U×V over the pixels about each."""

    liquid: LightPaths
    air: LightPaths
    points: EntryPoints
    mean_cross: Float64[np.ndarray, "pixels 3"]

    @classmethod
    def of(
        cls,
        liquid: LightPaths,
        air: LightPaths,
        points: EntryPoints,
        *,
        pixels: np.ndarray,
        used: np.ndarray,
        shape: tuple[int, int],
    ) -> "PathCrossing":
        """Average the angles of the ``used`` ones of ``pixels``, which number the grid row by row."""
        grid = np.zeros((shape[0] * shape[1], 4))
        own = np.cross(liquid.direction, air.direction)
        grid[pixels[used], :3] = own[used]
        grid[pixels[used], 3] = 1.0
        window = (ANGLE_WINDOW_PX, ANGLE_WINDOW_PX)
        total = cv2.boxFilter(
            grid.reshape(*shape, 4), cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        here = total.reshape(-1, 4)[pixels]
        mean = here[:, :3] / np.maximum(here[:, 3:], 1.0)
        # Across an edge the mean belongs to neither side.
        share = (own * mean).sum(axis=1)
        alike = (share > LEAST_ALIKE * (own**2).sum(axis=1)) & (LEAST_ALIKE * share < (own**2).sum(axis=1))
        return cls(liquid, air, points, np.where(alike[:, None], mean, own))

    def ratio(self) -> PerPath:
        """Return the sine of each pixel's own angle over that of the mean one."""
        cross = np.cross(self.liquid.direction, self.air.direction)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.linalg.norm(cross, axis=1) / np.linalg.norm(self.mean_cross, axis=1)

    def measured_near(self, distance_mm: PerPath) -> tuple[PerPath, PerPath]:
        """Return the distance along the liquid path that each crossing tells, and its sd, for a surface near ``distance_mm``.

        At that distance the air path passes the liquid path by (t − t̂) sin θ; by the mean angle, that many mm are still to go.
        """
        sine = np.linalg.norm(self.mean_cross, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            common = self.mean_cross / sine[:, None]
            told = distance_mm - (distance_mm - self.points.distance_liquid_mm) * self.ratio()
            along_air = ((self.liquid.point_at(distance_mm) - self.air.near_mm) * self.air.direction).sum(axis=1)
            across = np.cross(self.air.direction, common)
            variance = np.zeros(len(sine))
            for covariance in (self.liquid.covariance_at(distance_mm), self.air.covariance_at(along_air)):
                variance += np.einsum("pi,pij,pj->p", across, covariance, across)
            return told, np.sqrt(variance) / sine
