"""What the noise of the correspondences does to a pixel's distance and normal, drawn at random, to first order."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int

from recon.compiled import compiled
from recon.geometry.light_paths import LightPaths

Vectors = Float64[np.ndarray, "pixels 3"]
PerPath = Float64[np.ndarray, " pixels"]
SmallVectors = Float32[np.ndarray, "some 3"]


@dataclass(frozen=True, slots=True, eq=False)
class PathNoise:
    """Two paths a pixel with the noise of their display points, and the normal that is made of them."""

    liquid: LightPaths
    air: LightPaths
    normal: Vectors
    n_liquid: float
    n_air: float

    def draw(
        self,
        rng: np.random.Generator,
        rows: Int[np.ndarray, " some"],
        *,
        along_liquid_mm: PerPath,
        along_air_mm: PerPath,
        mean_cross: Vectors,
        facing: PerPath,
        curvature: Float32[np.ndarray, "pixels 3 3"],
    ) -> tuple[Float32[np.ndarray, " some"], SmallVectors, SmallVectors, SmallVectors]:
        """Draw errors of the distance along the liquid path and of the normal, how far that path slides, and its own turn.

        Along the surface it slides from where it meets it without the noise to where it does with it. The error of the normal is
        that as the normal of the latter place, its own turn that as the normal of the former, where the pixel looks. All follow
        from the same eight numbers a pixel, and are told for some ``rows`` of them.

        Parameters
        ----------
        along_liquid_mm, along_air_mm
            Where the surface is on the two paths.
        mean_cross
            U×V of the two paths, the mean over pixels about each: by it the distance follows from the paths' shift.
        facing, curvature
            The cosine between liquid path and normal, and how the normal turns along the surface: it is that of the place which
            the path meets.
        """
        distance_error = np.empty(len(rows), np.float32)
        normal_error, slide, own_turn = (np.empty((len(rows), 3), np.float32) for _ in range(3))
        noises = [noise for paths in (self.liquid, self.air) for noise in (paths.near_noise, paths.far_noise)]
        near_liquid, far_liquid, near_air, far_air = (rng.standard_normal(noise.sd_mm.shape) for noise in noises)
        for noise, drawn in zip(noises, (near_liquid, far_liquid, near_air, far_air), strict=True):
            drawn *= noise.sd_mm
        _write_errors(
            rows,
            np.stack([noise.axes for noise in noises]),
            near_liquid,
            far_liquid,
            near_air,
            far_air,
            self.liquid.direction,
            self.air.direction,
            self.liquid.baseline_mm,
            self.air.baseline_mm,
            along_liquid_mm,
            along_air_mm,
            self.normal,
            mean_cross,
            facing,
            curvature,
            self.n_liquid,
            self.n_air,
            distance_error,
            normal_error,
            slide,
            own_turn,
        )
        return distance_error, normal_error, slide, own_turn


@compiled
def _write_errors(
    rows: np.ndarray,
    axes: np.ndarray,
    near_liquid: np.ndarray,
    far_liquid: np.ndarray,
    near_air: np.ndarray,
    far_air: np.ndarray,
    liquid: np.ndarray,
    air: np.ndarray,
    baseline_liquid: np.ndarray,
    baseline_air: np.ndarray,
    along_liquid: np.ndarray,
    along_air: np.ndarray,
    normal: np.ndarray,
    mean_cross: np.ndarray,
    facing: np.ndarray,
    curvature: np.ndarray,
    n_liquid: float,
    n_air: float,
    distance_error: np.ndarray,
    normal_error: np.ndarray,
    slide: np.ndarray,
    own_turn: np.ndarray,
) -> None:
    """Write what shifts of the four display points, along the axes of their displays, do to each of some pixels."""
    shift_liquid, turn_liquid, shift_air, turn_air = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    change = np.empty(3)
    for number in range(len(rows)):
        row = rows[number]
        n = normal[row]
        _write_path_error(
            axes[0],
            axes[1],
            near_liquid[row],
            far_liquid[row],
            liquid[row],
            baseline_liquid[row],
            along_liquid[row],
            shift_liquid,
            turn_liquid,
        )
        _write_path_error(
            axes[2],
            axes[3],
            near_air[row],
            far_air[row],
            air[row],
            baseline_air[row],
            along_air[row],
            shift_air,
            turn_air,
        )
        # The normal is ± this difference over its length; only what is at right angles to it turns it.
        signed_length, lifted = 0.0, 0.0
        for k in range(3):
            signed_length += (n_liquid * liquid[row, k] - n_air * air[row, k]) * n[k]
            lifted += shift_liquid[k] * n[k]
        upward = 0.0
        for k in range(3):
            change[k] = (n_liquid * turn_liquid[k] - n_air * turn_air[k]) / signed_length
            upward += change[k] * n[k]
        lifted /= facing[row]
        for k in range(3):
            change[k] -= upward * n[k]
            # From here on, where the path meets the surface.
            turn_liquid[k] = shift_liquid[k] + lifted * liquid[row, k]
        along, squared = 0.0, 0.0
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            across = (shift_liquid[a] - shift_air[a]) * air[row, b] - (shift_liquid[b] - shift_air[b]) * air[row, a]
            along += across * mean_cross[row, k]
            squared += mean_cross[row, k] ** 2
        distance_error[number] = -along / squared
        for k in range(3):
            slide[number, k] = turn_liquid[k]
            own_turn[number, k] = change[k]
            bent = 0.0
            for j in range(3):
                bent += curvature[row, k, j] * turn_liquid[j]
            normal_error[number, k] = change[k] - bent


@compiled
def _write_path_error(
    near_axes: np.ndarray,
    far_axes: np.ndarray,
    near: np.ndarray,
    far: np.ndarray,
    direction: np.ndarray,
    baseline: float,
    along: float,
    shift: np.ndarray,
    turn: np.ndarray,
) -> None:
    """Write by how much a path is shifted at a distance, and by how much its direction turns."""
    lengthwise = 0.0
    for k in range(3):
        here = near_axes[k, 0] * near[0] + near_axes[k, 1] * near[1]
        turn[k] = (here - far_axes[k, 0] * far[0] - far_axes[k, 1] * far[1]) / baseline
        shift[k] = here + along * turn[k]
        lengthwise += turn[k] * direction[k]
    for k in range(3):
        turn[k] -= lengthwise * direction[k]
