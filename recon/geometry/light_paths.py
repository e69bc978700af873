"""The path before contact (PBC): the straight line through a pixel's two display points, one at each position.

Paths are stored as a point on the nearer display and a unit direction from the display towards the camera side. Each
carries the covariance of a small shift of the line at any distance along it, since the two display points are the
only things that were measured.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.sessions.manifest import CoverGlass, Pose


@dataclass(frozen=True, slots=True, eq=False)
class ScreenNoise:
    """Noise of points on a display: independent standard deviations along its two axes [3, 2], unit vectors in the world.

    A covariance matrix a point would take four times the memory.
    """

    sd_mm: Float64[np.ndarray, "pixels 2"]
    axes: Float64[np.ndarray, "3 2"]

    def __getitem__(self, pixels: np.ndarray | slice) -> "ScreenNoise":
        """Return that of some of the points."""
        return ScreenNoise(self.sd_mm[pixels], self.axes)

    def covariance(self) -> Float64[np.ndarray, "pixels 3 3"]:
        """Return the covariances in mm²."""
        outer = np.einsum("ia,ja->aij", self.axes, self.axes)
        return (self.sd_mm**2 @ outer.reshape(2, 9)).reshape(-1, 3, 3)

    def variance_along(self, direction: Float64[np.ndarray, "pixels 3"]) -> Float64[np.ndarray, " pixels"]:
        """Return the variance of each point's error along a vector, times the vector's square."""
        return ((direction @ self.axes * self.sd_mm) ** 2).sum(axis=1)

    def drawn(self, rng: np.random.Generator) -> Float64[np.ndarray, "pixels 3"]:
        """Draw one error a point."""
        return (self.sd_mm * rng.standard_normal(self.sd_mm.shape)) @ self.axes.T


@dataclass(frozen=True, slots=True, eq=False)
class LightPaths:
    """One line a pixel, from the display farther from the camera to ``near_mm`` on the nearer one, ``baseline_mm`` long.

    ``direction`` is the unit vector that way: towards the object. ``near_noise`` and ``far_noise`` are those of the two
    display points.
    """

    near_mm: Float64[np.ndarray, "pixels 3"]
    direction: Float64[np.ndarray, "pixels 3"]
    baseline_mm: Float64[np.ndarray, " pixels"]
    near_noise: ScreenNoise
    far_noise: ScreenNoise

    @property
    def far_mm(self) -> Float64[np.ndarray, "pixels 3"]:
        """The points on the display farther from the camera."""
        return self.near_mm - self.baseline_mm[:, None] * self.direction

    @property
    def near_covariance(self) -> Float64[np.ndarray, "pixels 3 3"]:
        """Covariances of the nearer display points in mm²."""
        return self.near_noise.covariance()

    @property
    def far_covariance(self) -> Float64[np.ndarray, "pixels 3 3"]:
        """Covariances of the farther display points in mm²."""
        return self.far_noise.covariance()

    def some(self, pixels: np.ndarray | slice) -> "LightPaths":
        """Return the paths of some of the pixels."""
        return LightPaths(*(getattr(self, name)[pixels] for name in LightPaths.__slots__))

    def point_at(self, distance_mm: Float64[np.ndarray, " pixels"]) -> Float64[np.ndarray, "pixels 3"]:
        """Return the point at a distance beyond the nearer display, towards the object."""
        return self.near_mm + distance_mm[:, None] * self.direction

    def covariance_at(self, distance_mm: Float64[np.ndarray, " pixels"]) -> Float64[np.ndarray, "pixels 3 3"]:
        """Return the covariance of the line's place at that distance: the lever of the two display points."""
        lever = (distance_mm / self.baseline_mm)[:, None, None]
        result, far = self.near_covariance, self.far_covariance
        result *= (1 + lever) ** 2
        far *= lever**2
        result += far
        return result

    def variance_along(
        self, direction: Float64[np.ndarray, "pixels 3"], distance_mm: Float64[np.ndarray, " pixels"]
    ) -> Float64[np.ndarray, " pixels"]:
        """Return the variance along a vector of each line's place at a distance."""
        lever = distance_mm / self.baseline_mm
        near, far = self.near_noise.variance_along(direction), self.far_noise.variance_along(direction)
        return (1 + lever) ** 2 * near + lever**2 * far

    def turn_variance_along(self, direction: Float64[np.ndarray, "pixels 3"]) -> Float64[np.ndarray, " pixels"]:
        """Return the variance of each line's direction along a vector at right angles to it."""
        near, far = self.near_noise.variance_along(direction), self.far_noise.variance_along(direction)
        return (near + far) / self.baseline_mm**2

    def direction_variance(self) -> Float64[np.ndarray, " pixels"]:
        """Return the summed variances of the unit direction: the trace of its covariance."""
        near, far = self.near_noise.variance_along(self.direction), self.far_noise.variance_along(self.direction)
        # The display's axes are unit vectors, so that a covariance's trace is the sum of both variances.
        whole = (self.near_noise.sd_mm**2).sum(axis=1) + (self.far_noise.sd_mm**2).sum(axis=1)
        return (whole - near - far) / self.baseline_mm**2

    def direction_covariance(self) -> Float64[np.ndarray, "pixels 3 3"]:
        """Return the covariance of the unit direction; a shift of a display point along the line turns nothing."""
        shift = (self.near_covariance + self.far_covariance) / self.baseline_mm[:, None, None] ** 2
        across = np.eye(3) - self.direction[:, :, None] * self.direction[:, None, :]
        return across @ shift @ across


def light_paths(
    screen_mm: tuple[Float64[np.ndarray, "pixels 2"], Float64[np.ndarray, "pixels 2"]],
    sd_mm: tuple[Float64[np.ndarray, "pixels 2"], Float64[np.ndarray, "pixels 2"]],
    poses: tuple[Pose, Pose],
    *,
    cover_glass: CoverGlass | None,
    n_medium: float,
) -> LightPaths:
    """Return the PBC of each pixel from its screen coordinates at positions 0 and 1.

    Which position is nearer to the camera follows from the screens' own z axes, which point away from the viewer.
    """
    transforms = [pose.world_from_screen() for pose in poses]
    order = nearer_first(poses)
    near, far = (_to_world(screen_mm[k], transforms[k]) for k in order)
    if cover_glass is not None:
        near, far = _through_glass(near, far, [transforms[k] for k in order], glass=cover_glass, n_medium=n_medium)
    span = near - far
    baseline = np.linalg.norm(span, axis=1)
    return LightPaths(
        near_mm=near,
        direction=span / baseline[:, None],
        baseline_mm=baseline,
        near_noise=ScreenNoise(sd_mm[order[0]], transforms[order[0]][:3, :2]),
        far_noise=ScreenNoise(sd_mm[order[1]], transforms[order[1]][:3, :2]),
    )


def nearer_first(poses: tuple[Pose, Pose]) -> tuple[int, int]:
    """Return the two positions, that of the display nearer to the camera first."""
    first, second = (pose.world_from_screen() for pose in poses)
    return (0, 1) if (second[:3, 3] - first[:3, 3]) @ first[:3, 2] > 0 else (1, 0)


def _to_world(screen_mm: np.ndarray, world_from_screen: np.ndarray) -> np.ndarray:
    return screen_mm @ world_from_screen[:3, :2].T + world_from_screen[:3, 3]


def _through_glass(
    near: np.ndarray,
    far: np.ndarray,
    transforms: list[np.ndarray],
    *,
    glass: CoverGlass,
    n_medium: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Move each display point from the pixel plane to where its light leaves the cover glass.

    The direction outside is not known beforehand; for parallel screens the first guess is already exact, since both
    points are shifted alike, and tilted ones converge in a few rounds.
    """
    outer_near, outer_far = near, far
    for _ in range(5):
        direction = outer_near - outer_far
        direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        outer_near = near + _glass_shift(direction, transforms[0], glass=glass, n_medium=n_medium)
        outer_far = far + _glass_shift(direction, transforms[1], glass=glass, n_medium=n_medium)
    return outer_near, outer_far


def _glass_shift(
    direction: np.ndarray, world_from_screen: np.ndarray, *, glass: CoverGlass, n_medium: float
) -> np.ndarray:
    """Return the vector from the pixel plane to the glass's outer face along the path inside (Snell, plane sheet)."""
    outward = -world_from_screen[:3, 2]
    along = direction @ outward
    across = direction - along[:, None] * outward
    across_inside = across * (n_medium / glass.n)
    along_inside = np.sqrt(np.maximum(1 - (across_inside**2).sum(1), 1e-12))
    return glass.thickness_mm * (outward + across_inside / along_inside[:, None])
