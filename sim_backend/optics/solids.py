"""Solid bodies from quadrics and planes, joined, intersected and subtracted along each ray.

A solid answers one question: where does a ray cross your boundary? Boolean operations work on those crossings alone
(constructive solid geometry by interval logic; Roth, *Ray casting for modeling solids*, 1982), so every combination of
simple bodies is exact: no mesh, no facets.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float64, Int64

Vectors = Float64[np.ndarray, "rays 3"]
Distances = Float64[np.ndarray, "rays crossings"]


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """Where each ray crosses a solid's boundary.

    ``distance`` ascends along each row and is padded with infinity; ``surface`` numbers the leaf that is crossed;
    ``starts_inside`` tells whether the ray lies inside infinitely far back. Crossings alternate between in and out.
    """

    distance: Distances
    surface: Int64[np.ndarray, "rays crossings"]
    starts_inside: Bool[np.ndarray, " rays"]


@runtime_checkable
class Solid(Protocol):
    """A region of space bounded by simple surfaces."""

    def leaves(self) -> tuple["Leaf", ...]:
        """Return the surfaces that bound the solid, in the order of their numbers."""
        ...

    def crossings(self, origin: Vectors, direction: Vectors) -> Crossings:
        """Return every crossing of the lines ``origin + t direction``, for t of either sign."""
        ...


@runtime_checkable
class Leaf(Solid, Protocol):
    """A solid with a single surface."""

    def is_convex(self) -> bool:
        """Whether every line meets the solid in one piece."""
        ...

    def value(self, points: Vectors) -> Float64[np.ndarray, " rays"]:
        """Return the defining function: negative inside, zero on the surface."""
        ...

    def gradient(self, points: Vectors) -> Vectors:
        """Return the gradient of the defining function, which points out of the solid."""
        ...


def _dot(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", left, right)


@dataclass(frozen=True, slots=True, eq=False)
class HalfSpace:
    """Everything behind the plane through ``point`` with outward ``normal``."""

    point: Float64[np.ndarray, " 3"]
    normal: Float64[np.ndarray, " 3"]

    def is_convex(self) -> bool:
        """A half-space is convex."""
        return True

    def leaves(self) -> tuple[Leaf, ...]:
        """Return the plane itself."""
        return (self,)

    def value(self, points: Vectors) -> Float64[np.ndarray, " rays"]:
        """Return the signed distance times the normal's length."""
        return (points - self.point) @ self.normal

    def gradient(self, points: Vectors) -> Vectors:
        """Return the plane's normal at each point."""
        return np.broadcast_to(self.normal, points.shape).copy()

    def crossings(self, origin: Vectors, direction: Vectors) -> Crossings:
        """Return the one crossing of each ray; none where the ray runs along the plane."""
        slope = direction @ self.normal
        height = self.value(origin)
        parallel = slope == 0
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(parallel, np.inf, -height / slope)
        starts_inside = np.where(parallel, height <= 0, slope > 0)
        return Crossings(distance[:, None], np.zeros((len(origin), 1), np.int64), starts_inside)


@dataclass(frozen=True, slots=True, eq=False)
class Quadric:
    """The points with x·Mx + b·x + c ≤ 0, for a symmetric matrix M."""

    matrix: Float64[np.ndarray, "3 3"]
    linear: Float64[np.ndarray, " 3"]
    constant: float

    def is_convex(self) -> bool:
        """Convex where the matrix has no negative eigenvalue (spheres, ellipsoids, cylinders; not cones)."""
        return bool(np.linalg.eigvalsh(self.matrix)[0] >= -1e-12 * np.abs(self.matrix).max())

    def leaves(self) -> tuple[Leaf, ...]:
        """Return the surface itself."""
        return (self,)

    def value(self, points: Vectors) -> Float64[np.ndarray, " rays"]:
        """Return x·Mx + b·x + c."""
        return _dot(points @ self.matrix + self.linear, points) + self.constant

    def gradient(self, points: Vectors) -> Vectors:
        """Return 2Mx + b."""
        return 2 * points @ self.matrix + self.linear

    def crossings(self, origin: Vectors, direction: Vectors) -> Crossings:
        """Solve the quadratic along each ray in the form that does not lose digits to cancellation."""
        along = direction @ self.matrix
        square = _dot(along, direction)
        half = _dot(along, origin) + 0.5 * (direction @ self.linear)
        rest = self.value(origin)
        discriminant = half * half - square * rest
        met = discriminant > 0
        root = np.sqrt(np.where(met, discriminant, 0.0))
        larger = -(half + np.copysign(root, half))
        with np.errstate(divide="ignore", invalid="ignore"):
            first = np.where(square == 0, np.inf, larger / square)
            second = np.where(larger == 0, np.where(square == 0, np.inf, 0.0), rest / larger)
        near = np.where(met, np.minimum(first, second), np.inf)
        far = np.where(met, np.maximum(first, second), np.inf)
        # Infinitely far back the highest power that does not vanish decides the sign.
        starts_inside = np.where(square != 0, square < 0, np.where(half != 0, half > 0, rest <= 0))
        distance = np.stack([near, far], axis=1)
        return Crossings(distance, np.zeros(distance.shape, np.int64), starts_inside)


@dataclass(frozen=True, slots=True, eq=False)
class Complement:
    """Everything outside ``solid``."""

    solid: Solid

    def leaves(self) -> tuple[Leaf, ...]:
        """Return the surfaces of the solid."""
        return self.solid.leaves()

    def crossings(self, origin: Vectors, direction: Vectors) -> Crossings:
        """Return the solid's crossings with in and out exchanged."""
        found = self.solid.crossings(origin, direction)
        return Crossings(found.distance, found.surface, ~found.starts_inside)


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """The points that lie in at least ``needed`` of ``solids``: 1 is their union, all of them the intersection."""

    solids: tuple[Solid, ...]
    needed: int

    def leaves(self) -> tuple[Leaf, ...]:
        """Return the surfaces of all parts, one part after the other."""
        return tuple(leaf for solid in self.solids for leaf in solid.leaves())

    def crossings(self, origin: Vectors, direction: Vectors) -> Crossings:
        """Merge the crossings of the parts, and keep those where the number of parts entered passes ``needed``."""
        if self.needed == len(self.solids) and all(
            isinstance(solid, HalfSpace | Quadric) and solid.is_convex() for solid in self.solids
        ):
            return _convex_intersection(self.solids, origin, direction)
        parts = [solid.crossings(origin, direction) for solid in self.solids]
        offsets = np.cumsum([0, *(len(solid.leaves()) for solid in self.solids)])
        distance = np.concatenate([part.distance for part in parts], axis=1)
        surface = np.concatenate([part.surface + offset for part, offset in zip(parts, offsets[:-1], strict=True)], 1)
        step = np.concatenate([_steps(part) for part in parts], axis=1)
        order = np.argsort(distance, axis=1, kind="stable")
        distance = np.take_along_axis(distance, order, 1)
        depth_at_start = np.sum([part.starts_inside for part in parts], axis=0)
        depth = depth_at_start[:, None] + np.cumsum(np.take_along_axis(step, order, 1), axis=1)
        inside = depth >= self.needed
        starts_inside = depth_at_start >= self.needed
        before = np.concatenate([starts_inside[:, None], inside[:, :-1]], axis=1)
        changes = (inside != before) & np.isfinite(distance)
        return _compact(distance, np.take_along_axis(surface, order, 1), changes, starts_inside)


def _steps(part: Crossings) -> Int64[np.ndarray, "rays crossings"]:
    """Return +1 where a crossing leads in, -1 where it leads out, 0 for padding."""
    alternating = np.where(np.arange(part.distance.shape[1]) % 2 == 0, 1, -1)
    signs = np.where(part.starts_inside[:, None], -alternating, alternating)
    return np.where(np.isfinite(part.distance), signs, 0)


def _compact(
    distance: Distances,
    surface: Int64[np.ndarray, "rays crossings"],
    keep: Bool[np.ndarray, "rays crossings"],
    starts_inside: Bool[np.ndarray, " rays"],
) -> Crossings:
    """Move the kept crossings of each ray to the front and drop the columns that nobody needs."""
    width = max(1, int(keep.sum(axis=1).max(initial=0)))
    distance = np.where(keep, distance, np.inf)
    order = np.argsort(distance, axis=1, kind="stable")[:, :width]
    return Crossings(np.take_along_axis(distance, order, 1), np.take_along_axis(surface, order, 1), starts_inside)


def _convex_intersection(solids: Sequence[Solid], origin: Vectors, direction: Vectors) -> Crossings:
    """Intersect convex leaves: the last way in and the first way out, without sorting."""
    enter = np.full(len(origin), -np.inf)
    leave = np.full(len(origin), np.inf)
    enter_surface = np.zeros(len(origin), np.int64)
    leave_surface = np.zeros(len(origin), np.int64)
    for number, solid in enumerate(solids):
        found = solid.crossings(origin, direction)
        first = found.distance[:, 0]
        last = found.distance[:, -1]
        one_sided = ~np.isfinite(last) if found.distance.shape[1] > 1 else np.ones(len(origin), bool)
        way_in = np.where(found.starts_inside, -np.inf, first)
        way_out = np.where(one_sided, np.where(found.starts_inside, first, np.inf), last)
        later, sooner = way_in > enter, way_out < leave
        enter, enter_surface = np.where(later, way_in, enter), np.where(later, number, enter_surface)
        leave, leave_surface = np.where(sooner, way_out, leave), np.where(sooner, number, leave_surface)
    met = enter < leave
    starts_inside = met & np.isneginf(enter)
    first = np.where(met, np.where(starts_inside, leave, enter), np.inf)
    first_surface = np.where(starts_inside, leave_surface, enter_surface)
    second = np.where(met & ~starts_inside, leave, np.inf)
    return Crossings(np.stack([first, second], axis=1), np.stack([first_surface, leave_surface], axis=1), starts_inside)


def union(*solids: Solid) -> Combination:
    """Return the points in any of the solids."""
    return Combination(solids, 1)


def intersection(*solids: Solid) -> Combination:
    """Return the points in all of the solids."""
    return Combination(solids, len(solids))


def difference(solid: Solid, *removed: Solid) -> Combination:
    """Return the points of ``solid`` that lie in none of the ``removed``."""
    return Combination((solid, *(Complement(other) for other in removed)), 1 + len(removed))


def contains(solid: Solid, points: Vectors) -> Bool[np.ndarray, " rays"]:
    """Tell which points lie inside, by counting the crossings behind them along a fixed slanted line."""
    direction = np.broadcast_to(np.array([0.36, 0.48, 0.8]), points.shape)
    found = solid.crossings(points, direction)
    return found.starts_inside ^ ((found.distance < 0).sum(axis=1) % 2 == 1)
