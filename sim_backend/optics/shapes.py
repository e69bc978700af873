"""The common quadrics and planes, named: spheres, ellipsoids, cylinders, cones, slabs."""

import numpy as np

from sim_backend.optics.solids import Combination, HalfSpace, Quadric, intersection

Number = float | int
Triple = tuple[Number, Number, Number] | np.ndarray


def half_space(point: Triple, outward_normal: Triple) -> HalfSpace:
    """Return everything behind the plane through ``point``; the normal is brought to length 1."""
    normal = np.array(outward_normal, dtype=np.float64)
    return HalfSpace(np.array(point, dtype=np.float64), normal / np.linalg.norm(normal))


def ellipsoid(centre: Triple, semi_axes: Triple) -> Quadric:
    """Return the ellipsoid with its axes along x, y and z."""
    middle = np.array(centre, dtype=np.float64)
    matrix = np.diag(1 / np.square(np.array(semi_axes, dtype=np.float64)))
    return Quadric(matrix, -2 * matrix @ middle, float(middle @ matrix @ middle) - 1)


def sphere(centre: Triple, radius: Number) -> Quadric:
    """Return a ball."""
    middle = np.array(centre, dtype=np.float64)
    return Quadric(np.eye(3), -2 * middle, float(middle @ middle) - radius**2)


def cylinder(point: Triple, axis: Triple, radius: Number) -> Quadric:
    """Return the endless cylinder about the line through ``point`` along ``axis``."""
    middle, along = np.array(point, dtype=np.float64), np.array(axis, dtype=np.float64)
    along = along / np.linalg.norm(along)
    matrix = np.eye(3) - np.outer(along, along)
    return Quadric(matrix, -2 * matrix @ middle, float(middle @ matrix @ middle) - radius**2)


def elliptic_cylinder(centre: Triple, semi_x: Number, semi_y: Number) -> Quadric:
    """Return the endless cylinder along z with an elliptic section."""
    middle = np.array(centre, dtype=np.float64)
    matrix = np.diag([1 / semi_x**2, 1 / semi_y**2, 0.0])
    return Quadric(matrix, -2 * matrix @ middle, float(middle @ matrix @ middle) - 1)


def cone(apex: Triple, axis: Triple, radius_per_height: Number) -> Combination:
    """Return the endless cone that opens from ``apex`` in the direction ``axis`` (one nappe)."""
    tip, along = np.array(apex, dtype=np.float64), np.array(axis, dtype=np.float64)
    along = along / np.linalg.norm(along)
    matrix = np.eye(3) - (1 + radius_per_height**2) * np.outer(along, along)
    both_nappes = Quadric(matrix, -2 * matrix @ tip, float(tip @ matrix @ tip))
    return intersection(both_nappes, half_space(apex, -along))


def slab(low_z: Number, high_z: Number) -> tuple[HalfSpace, HalfSpace]:
    """Return the two half-spaces whose intersection is low_z ≤ z ≤ high_z."""
    return half_space((0, 0, low_z), (0, 0, -1)), half_space((0, 0, high_z), (0, 0, 1))
