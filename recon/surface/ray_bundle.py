"""The rays on which normals are integrated, and how the unknown changes from one to the next on a surface of given normal.

The unknown of a pixel is the distance along its ray, or the logarithm of the distance where all rays meet in one point: then
the equations are linear in it, and exact.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

VectorMap = Float64[np.ndarray, "rows cols 3"]
ScalarMap = Float64[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]
Vectors = Float64[np.ndarray, "pixels 3"]
Numbers = Float64[np.ndarray, " pixels"]


@dataclass(frozen=True, slots=True, eq=False)
class RayBundle:
    """Rays of the camera's grid.

    ``place_mm`` is a point of each ray near the surface and ``start`` the unknown there; ``sight`` the ray's direction, whose
    length is the unit of the distance. With ``central`` all rays leave one point, ``place_mm`` is each one's direction, and the
    unknown is a logarithm.
    """

    place_mm: VectorMap
    sight: VectorMap
    start: ScalarMap
    central: bool

    @classmethod
    def from_one_centre(cls, direction: VectorMap) -> "RayBundle":
        """Return rays that leave one point."""
        return cls(direction, direction, np.zeros(direction.shape[:2]), central=True)

    @classmethod
    def at_distance(cls, origin_mm: VectorMap, direction: VectorMap, distance_mm: ScalarMap) -> "RayBundle":
        """Return rays of any kind, about the distances given; nothing is neglected where those turn out to be the surface's."""
        return cls(origin_mm + distance_mm[..., None] * direction, direction, distance_mm, central=False)

    def complete(self) -> Mask:
        """Return the pixels that have a ray."""
        return np.isfinite(self.place_mm).all(axis=2) & np.isfinite(self.sight).all(axis=2) & np.isfinite(self.start)

    def spacing(self, mask: Mask) -> float:
        """Return the distance of neighbouring rays in units of the unknown."""
        steps = np.linalg.norm(np.diff(self.place_mm, axis=1), axis=2)[mask[:, 1:] & mask[:, :-1]]
        lengths = np.linalg.norm(self.sight[mask], axis=1)
        return float(np.median(steps) / np.median(lengths)) if len(steps) and np.median(steps) > 0 else 1.0

    def of(self, mask: Mask) -> "PixelRays":
        """Return the rays of some pixels as a list."""
        return PixelRays(self.place_mm[mask], self.sight[mask], self.start[mask], self.central)


@dataclass(frozen=True, slots=True, eq=False)
class PixelRays:
    """The rays of some pixels, row by row; fields as of :class:`RayBundle`."""

    place_mm: Vectors
    sight: Vectors
    start: Numbers
    central: bool

    def facing(self, normal: Vectors, chosen: np.ndarray) -> Numbers:
        """Return the cosine between each normal and the ray of the pixel ``chosen`` for it."""
        sight = self.sight[chosen]
        return (normal * sight).sum(axis=1) / np.linalg.norm(sight, axis=1)

    def step(self, normal: Vectors, first: np.ndarray, second: np.ndarray) -> Numbers:
        """Return the change of the unknown from ``first`` to ``second`` on a plane at right angles to ``normal``."""
        sight = self.sight[first] if self.central else 0.5 * (self.sight[first] + self.sight[second])
        shift_mm = self.place_mm[second] - self.place_mm[first]
        return self._rise(normal, shift_mm, sight) + self.start[second] - self.start[first]

    def step_beside(self, normal: Vectors, shift_mm: Vectors, shift_of_start: Numbers) -> Numbers:
        """Return the change from each pixel's own ray to one that passes ``shift_mm`` beside its place."""
        return self._rise(normal, shift_mm, self.sight) + shift_of_start

    def _rise(self, normal: Vectors, shift_mm: Vectors, sight: Vectors) -> Numbers:
        with np.errstate(divide="ignore", invalid="ignore"):
            tilt = (normal * shift_mm).sum(axis=1) / (normal * sight).sum(axis=1)
            return -np.log1p(tilt) if self.central else -tilt
