"""The crossing of two light paths as a measurement of the distance along one of them, weighed without favour.

A pixel whose angle between the paths came out too large by noise has its crossing too near, and by its own numbers it is
surer than the others: weighed by them, a mean is biased. So each crossing is read near a surface that is roughly known, with
the angle that the pixels about it have on average.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from recon.bands import over_bands
from recon.compiled import compiled
from recon.geometry.entry_point import EntryPoints
from recon.geometry.light_paths import LightPaths

PerPath = Float64[np.ndarray, " pixels"]

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

    def measured_near(
        self, distance_mm: PerPath, *, levers_mm: tuple[PerPath, PerPath] | None = None, threads: int = 1
    ) -> tuple[PerPath, PerPath]:
        """Return the distance along the liquid path that each crossing tells, and its sd, for a surface near ``distance_mm``.

        At that distance the air path passes the liquid path within the mean plane of both; by the mean angle, that many mm are
        still to go. This is linear in the paths' noise, which therefore does not bias it. The sd grows with how far the surface
        is on both paths: ``levers_mm``, without the pixels' own noise, since a noisy path meets a surface at another distance,
        and its crossing would be weighed by its own error. So many ``threads`` share the pixels.
        """
        lever_mm, lever_air_mm = (distance_mm, self.along_air(distance_mm)) if levers_mm is None else levers_mm
        noises = [noise for paths in (self.liquid, self.air) for noise in (paths.near_noise, paths.far_noise)]
        axes = np.stack([noise.axes for noise in noises])
        told_mm, sd_mm = np.empty(len(distance_mm)), np.empty(len(distance_mm))

        def write(band: slice) -> None:
            liquid, air = self.liquid.some(band), self.air.some(band)
            _write_measured(
                *(liquid.near_mm, liquid.direction, liquid.baseline_mm, air.near_mm, air.direction, air.baseline_mm),
                *(self.mean_cross[band], axes),
                *(liquid.near_noise.sd_mm, liquid.far_noise.sd_mm, air.near_noise.sd_mm, air.far_noise.sd_mm),
                *(distance_mm[band], lever_mm[band], lever_air_mm[band], told_mm[band], sd_mm[band]),
            )

        over_bands(write, len(distance_mm), threads=threads)
        return told_mm, sd_mm

    def along_air(self, distance_mm: PerPath) -> PerPath:
        """Return where on the air path its nearest place to the liquid path's at ``distance_mm`` is."""
        return ((self.liquid.point_at(distance_mm) - self.air.near_mm) * self.air.direction).sum(axis=1)


@compiled
def _write_measured(
    near_liquid: np.ndarray,
    liquid: np.ndarray,
    baseline_liquid: np.ndarray,
    near_air: np.ndarray,
    air: np.ndarray,
    baseline_air: np.ndarray,
    mean_cross: np.ndarray,
    axes: np.ndarray,
    near_liquid_sd: np.ndarray,
    far_liquid_sd: np.ndarray,
    near_air_sd: np.ndarray,
    far_air_sd: np.ndarray,
    distance: np.ndarray,
    far: np.ndarray,
    far_air: np.ndarray,
    told: np.ndarray,
    sd: np.ndarray,
) -> None:
    """Write what each crossing tells near a distance, and its standard deviation; not a number where no mean angle is."""
    apart, across, on_axis = np.empty(3), np.empty(3), np.empty(4)
    for pixel in range(len(distance)):
        squared = 0.0
        for k in range(3):
            apart[k] = near_liquid[pixel, k] + distance[pixel] * liquid[pixel, k] - near_air[pixel, k]
            squared += mean_cross[pixel, k] ** 2
        sine = np.sqrt(squared)
        shift = 0.0
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            shift += (apart[a] * air[pixel, b] - apart[b] * air[pixel, a]) * mean_cross[pixel, k]
            across[k] = (air[pixel, a] * mean_cross[pixel, b] - air[pixel, b] * mean_cross[pixel, a]) / sine
        told[pixel] = distance[pixel] - shift / squared
        lever_liquid, lever_air = far[pixel] / baseline_liquid[pixel], far_air[pixel] / baseline_air[pixel]
        variance = 0.0
        for j in range(2):
            for display in range(4):
                on_axis[display] = 0.0
                for k in range(3):
                    on_axis[display] += axes[display, k, j] * across[k]
            variance += ((1 + lever_liquid) * near_liquid_sd[pixel, j] * on_axis[0]) ** 2
            variance += (lever_liquid * far_liquid_sd[pixel, j] * on_axis[1]) ** 2
            variance += ((1 + lever_air) * near_air_sd[pixel, j] * on_axis[2]) ** 2
            variance += (lever_air * far_air_sd[pixel, j] * on_axis[3]) ** 2
        sd[pixel] = np.sqrt(variance) / sine
