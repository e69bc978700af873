"""The crossing of two light paths as a measurement of the distance along one of them, weighed without favour.

A pixel whose angle between the paths came out too large by noise has its crossing too near, and by its own numbers it is
surer than the others: weighed by them, a mean is biased. So each crossing is read near a surface that is roughly known, with
the angle that the pixels about it have on average.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from recon.geometry.entry_point import EntryPoints
from recon.geometry.light_paths import LightPaths

PerPath = Float64[np.ndarray, " pixels"]
Vectors = Float64[np.ndarray, "pixels 3"]

# So many pixels across are averaged for an angle, noise of which is then a ninth.
ANGLE_WINDOW_PX = 9
# A mean counts where it is neither less than this share of the pixel's own nor more than its inverse.
LEAST_ALIKE = 0.7
# Or where noise alone sets the two so far apart.
NOISE_SD = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class PathCrossing:
    """Two paths for each of some pixels of the camera's grid, with the mean of U×V over the pixels about each.

    ``mean_sd`` is the standard deviation of that mean's length.
    """

    liquid: LightPaths
    air: LightPaths
    points: EntryPoints
    mean_cross: Float64[np.ndarray, "pixels 3"]
    mean_sd: PerPath

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
        # Without the pixel itself: its own noise would bias the weight of its own crossing.
        others = total.reshape(-1, 4)[pixels] - grid[pixels]
        mean = others[:, :3] / np.maximum(others[:, 3:], 1.0)
        # Across an edge the mean belongs to neither side.
        share, squared = (own * mean).sum(axis=1), (own**2).sum(axis=1)
        alike = (share > LEAST_ALIKE * squared) & (LEAST_ALIKE * share < squared)
        alike |= ((own - mean) ** 2).sum(axis=1) < (NOISE_SD * points.angle_sd_rad) ** 2
        alike &= others[:, 3] > 0
        sd = points.angle_sd_rad / np.sqrt(np.where(alike, np.maximum(others[:, 3], 1.0), 1.0))
        return cls(liquid, air, points, np.where(alike[:, None], mean, own), sd)

    def readable(self, *, angle_sigma: float) -> Bool[np.ndarray, " pixels"]:
        """Return the pixels whose mean angle is at least that many of its own standard deviations.

        A pixel's own angle would let through those that noise makes larger, and with them crossings that are too near.
        """
        return np.linalg.norm(self.mean_cross, axis=1) > angle_sigma * self.mean_sd

    def measured_near(self, distance_mm: PerPath) -> tuple[PerPath, PerPath]:
        """Return the distance along the liquid path that each crossing tells, and its sd, for a surface near ``distance_mm``.

        At that distance the air path passes the liquid path within the mean plane of both; by the mean angle, that many mm are
        still to go. This is linear in the paths' noise, which therefore does not bias it.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            told = distance_mm + self.by_shift(self.liquid.point_at(distance_mm) - self.air.near_mm)
            sine = np.linalg.norm(self.mean_cross, axis=1)
            across = np.cross(self.air.direction, self.mean_cross / sine[:, None])
            variance = self.liquid.variance_along(across, distance_mm)
            variance += self.air.variance_along(across, self.along_air(distance_mm))
            return told, np.sqrt(variance) / sine

    def by_shift(self, apart_mm: Vectors) -> PerPath:
        """Return how far along the liquid path the crossing lies from where that path is this far from a place on the other."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return -(np.cross(apart_mm, self.air.direction) * self.mean_cross).sum(axis=1) / (self.mean_cross**2).sum(
                axis=1
            )

    def along_air(self, distance_mm: PerPath) -> PerPath:
        """Return where on the air path its nearest place to the liquid path's at ``distance_mm`` is."""
        return ((self.liquid.point_at(distance_mm) - self.air.near_mm) * self.air.direction).sum(axis=1)
