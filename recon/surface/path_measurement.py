"""The two light paths of every pixel as the measurements that fusion asks for, near a surface that is roughly known."""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int

from recon.bands import over_bands, side_by_side
from recon.compiled import compiled
from recon.geometry.light_paths import LightPaths
from recon.method import Limits
from recon.reconstruct import Crossing
from recon.surface.curvature import curvature_of
from recon.surface.error_draws import NoiseDraw, SomePixels, SomeVectors
from recon.surface.path_crossing import ANGLE_WINDOW_PX, PathCrossing
from recon.surface.path_noise import PathNoise
from recon.surface.ray_chords import Mask, ScalarMap, VectorMap
from recon.surface.window_means import weighted_means

PerPath = Float64[np.ndarray, " pixels"]
# A path that runs along the surface would slide without end.
LEAST_FACING = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class PathMeasurement:
    """Crossing and noise of the paths of ``pixels``, which number the grid of ``shape`` row by row.

    ``surface_pixel`` marks those whose normal counts, ``readable`` those whose crossing does too; ``facing`` is the cosine
    between liquid path and normal. So many ``threads`` share the pixels.
    """

    crossing: PathCrossing
    paths: PathNoise
    pixels: Int[np.ndarray, " pixels"]
    surface_pixel: Bool[np.ndarray, " pixels"]
    readable: Bool[np.ndarray, " pixels"]
    facing: PerPath
    normal_map: VectorMap
    shape: tuple[int, int]
    threads: int = 1
    # Where curvatures were told last, and those: the last reading and the noise ask for the same ones.
    told: list[tuple[PerPath, Float32[np.ndarray, "pixels 3 3"]]] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        crossing: Crossing,
        surface_pixel: Bool[np.ndarray, " pixels"],
        *,
        shape: tuple[int, int],
        n_liquid: float,
        n_air: float,
        threads: int = 1,
    ) -> "PathMeasurement":
        """Prepare to measure by the paths of all pixels that were crossed."""
        liquid, normal, pixels = crossing.liquid, crossing.normal, crossing.pixels
        reading, normal_map = side_by_side(
            partial(
                PathCrossing.of, liquid, crossing.air, crossing.points, pixels=pixels, used=surface_pixel, shape=shape
            ),
            partial(_spread, normal, surface_pixel, pixels, shape),
            threads=threads,
        )
        return cls(
            crossing=reading,
            paths=PathNoise(liquid, crossing.air, normal, n_liquid, n_air),
            pixels=pixels,
            surface_pixel=surface_pixel,
            readable=surface_pixel & reading.readable(angle_sigma=Limits().angle_sigma),
            facing=np.maximum(-(liquid.direction * normal).sum(axis=1), LEAST_FACING),
            normal_map=normal_map,
            shape=shape,
            threads=threads,
        )

    def on_grid(self, values: np.ndarray, where: Bool[np.ndarray, " pixels"]) -> Float64[np.ndarray, "..."]:
        """Lay values out on the camera grid; NaN elsewhere."""
        return _spread(values, where, self.pixels, self.shape)

    def remeasure(self, distance_mm: ScalarMap) -> tuple[ScalarMap, ScalarMap]:
        """Return the distances along the liquid paths that the crossings tell near ``distance_mm``, and their sds.

        A crossing scatters about the tangent plane, but the liquid path meets the surface below it: by half the curvature times
        the path's squared shift along the surface. That correction is no surer than itself.
        """
        along, liquid = distance_mm.ravel()[self.pixels], self.paths.liquid
        levers, curvature = side_by_side(
            partial(self._levers, along), partial(self._curvature, along), threads=self.threads
        )
        told_mm, sd_mm = self.crossing.measured_near(along, levers_mm=levers, threads=self.threads)
        below_mm = 0.5 * _bent(liquid, along, self.paths.normal, curvature, threads=self.threads) / self.facing
        distance, distance_sd = side_by_side(
            lambda: self.on_grid(told_mm + below_mm, self.readable),
            lambda: self.on_grid(np.hypot(sd_mm, below_mm), self.readable),
            threads=self.threads,
        )
        return distance, distance_sd

    def noise_at(self, distance_mm: ScalarMap, used: Mask) -> NoiseDraw:
        """Return what draws the errors of distances and normals of the ``used`` pixels, on a surface at ``distance_mm``.

        The surface is sought where the shifted liquid path meets it, and its normal is another one there.
        """
        along = distance_mm.ravel()[self.pixels]
        rows = np.flatnonzero(used.ravel()[self.pixels])
        along_air, curvature = self.crossing.along_air(along), self._curvature(along)
        self.told.clear()

        def draw(rng: np.random.Generator) -> tuple[SomePixels, SomeVectors, SomeVectors, SomeVectors]:
            return self.paths.draw(
                rng,
                rows,
                along_liquid_mm=along,
                along_air_mm=along_air,
                mean_cross=self.crossing.mean_cross,
                facing=self.facing,
                curvature=curvature,
            )

        return draw

    def _levers(self, along_mm: PerPath) -> tuple[PerPath, PerPath]:
        """Return how far the surface is on both paths, the mean over the pixels about each."""
        both = self.on_grid(np.stack([along_mm, self.crossing.along_air(along_mm)], axis=1), self.surface_pixel)
        there = np.isfinite(both).all(axis=2)
        mean = weighted_means(np.moveaxis(both, -1, 0), there.astype(np.float64), window_px=ANGLE_WINDOW_PX)
        liquid, air = mean.reshape(2, -1)[:, self.pixels]
        return liquid, air

    def _curvature(self, along_mm: PerPath) -> Float32[np.ndarray, "pixels 3 3"]:
        if self.told and np.array_equal(self.told[0][0], along_mm, equal_nan=True):
            return self.told[0][1]
        self.told.clear()
        point_mm = self.on_grid(self.paths.liquid.point_at(along_mm), self.surface_pixel)
        used = np.isfinite(point_mm).all(axis=2) & np.isfinite(self.normal_map).all(axis=2)
        found = curvature_of(point_mm, self.normal_map, used, threads=self.threads).reshape(-1, 3, 3)[self.pixels]
        self.told.append((along_mm, found))
        return found


def _spread(
    values: np.ndarray, where: Bool[np.ndarray, " pixels"], pixels: Int[np.ndarray, " pixels"], shape: tuple[int, int]
) -> Float64[np.ndarray, "..."]:
    grid = np.full((shape[0] * shape[1], *values.shape[1:]), np.nan)
    # Most are asked for whole.
    if where.all():
        grid[pixels] = values
    else:
        grid[pixels[where]] = values[where]
    return grid.reshape(*shape, *values.shape[1:])


def _bent(
    liquid: LightPaths,
    along_mm: PerPath,
    normal: Float64[np.ndarray, "pixels 3"],
    curvature: Float32[np.ndarray, "pixels 3 3"],
    *,
    threads: int,
) -> PerPath:
    """Return how much the surface bends over the square of each path's slide along it, on the mean."""
    result = np.empty(len(along_mm))
    axes = np.stack([noise.axes for noise in (liquid.near_noise, liquid.far_noise)])

    def write(band: slice) -> None:
        some = liquid.some(band)
        _write_bent(
            *(some.direction, normal[band], along_mm[band] / some.baseline_mm, curvature[band]),
            *(axes, some.near_noise.sd_mm, some.far_noise.sd_mm, result[band]),
        )

    over_bands(write, len(result), threads=threads)
    return result


@compiled
def _write_bent(
    direction: np.ndarray,
    normal: np.ndarray,
    lever: np.ndarray,
    curvature: np.ndarray,
    axes: np.ndarray,
    near_sd: np.ndarray,
    far_sd: np.ndarray,
    bent: np.ndarray,
) -> None:
    """Write it. A shift d of a path moves where it meets the surface by d − V (n·d)/(n·V)."""
    slide = np.empty(3)
    for pixel in range(len(bent)):
        facing = 0.0
        for k in range(3):
            facing += direction[pixel, k] * normal[pixel, k]
        facing = facing if abs(facing) > LEAST_FACING else LEAST_FACING
        bent[pixel] = 0.0
        for display in range(2):
            for j in range(2):
                lifted = 0.0
                for k in range(3):
                    lifted += normal[pixel, k] * axes[display, k, j]
                for k in range(3):
                    slide[k] = axes[display, k, j] - direction[pixel, k] * lifted / facing
                height = 0.0
                for a in range(3):
                    for b in range(3):
                        height += slide[a] * curvature[pixel, a, b] * slide[b]
                sd = (1 + lever[pixel]) * near_sd[pixel, j] if display == 0 else lever[pixel] * far_sd[pixel, j]
                bent[pixel] += sd**2 * height
