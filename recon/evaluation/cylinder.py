"""A cylinder: fitted by MLESAC, and the errors against it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from recon.errors import ReconError
from recon.evaluation.consensus import Guesses, Residuals, best_guess, draw, judges, mlesac_score
from recon.evaluation.spread import Spread, angle_between_rad, spread_of, unit

Points = Float64[np.ndarray, "points 3"]
PerPoint = Float64[np.ndarray, " points"]

THRESHOLD_MM = 0.5  # the paper's, section "Real experiments"
MOST_GUESSES = 4000
MOST_STEPS = 50
REFINEMENTS = 30
SETTLED = 1e-10
# The ends of the axis leave out this share of the inliers: a stray point must not lengthen a bottle.
END_SHARE = 0.001
# Two normals this nearly parallel (sine) fix no axis.
SMALLEST_SINE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Cylinder:
    """An axis through ``point_mm`` along the unit vector ``axis``, and a radius; without ends."""

    point_mm: Float64[np.ndarray, " 3"]
    axis: Float64[np.ndarray, " 3"]
    radius_mm: float

    def outward_mm(self, point_mm: Points) -> Points:
        """Return the vectors from the axis to the points, at right angles to it."""
        offset = point_mm - self.point_mm
        return offset - (offset @ self.axis)[:, None] * self.axis

    def distance_mm(self, point_mm: Points) -> PerPoint:
        """Return signed distances to the surface, positive outside."""
        first, second = _across(self.axis)
        offset = point_mm - self.point_mm
        return np.hypot(offset @ first, offset @ second) - self.radius_mm


@dataclass(frozen=True, slots=True, eq=False)
class CylinderFit:
    """A cylinder, its height as the inliers show it, and the errors of all points against it."""

    cylinder: Cylinder
    height_mm: float
    inlier: Bool[np.ndarray, " points"]
    position_mm: Spread
    normal_rad: Spread

    @property
    def inlier_share(self) -> float:
        """Share of all points within the threshold."""
        return float(self.inlier.mean())


def fit_cylinder(
    point_mm: Points, normal: Points, *, rng: np.random.Generator, threshold_mm: float = THRESHOLD_MM
) -> CylinderFit:
    """Fit a cylinder and judge all points: distance to the axis less the radius, and angle of radius and normal."""
    cylinder = mlesac_cylinder(point_mm, normal, threshold_mm=threshold_mm, rng=rng)
    outward = cylinder.outward_mm(point_mm)
    radial = unit(outward)
    if np.nansum(radial * normal) < 0:
        radial = -radial
    distance_mm = cylinder.distance_mm(point_mm)
    inlier = np.abs(distance_mm) <= threshold_mm
    along_mm = (point_mm - cylinder.point_mm)[inlier] @ cylinder.axis
    low, high = np.quantile(along_mm, [END_SHARE, 1 - END_SHARE]) if inlier.any() else (np.nan, np.nan)
    return CylinderFit(
        cylinder=cylinder,
        height_mm=float(high - low),
        inlier=inlier,
        position_mm=spread_of(distance_mm),
        normal_rad=spread_of(angle_between_rad(normal, radial)),
    )


def mlesac_cylinder(point_mm: Points, normal: Points, *, threshold_mm: float, rng: np.random.Generator) -> Cylinder:
    """Return the most likely cylinder, refined by least squares over the points within ``threshold_mm``.

    Two points with their normals make a guess: both normals cross the axis at right angles. Points without a normal
    judge, but make no guess.
    """
    with_normal = np.flatnonzero(np.isfinite(normal).all(axis=1))
    if len(with_normal) < 2 or len(point_mm) < 5:
        raise ReconError(f"a cylinder needs 5 points and 2 normals, {len(point_mm)} and {len(with_normal)} given")
    jury = judges(point_mm, rng)
    span_mm = float(np.linalg.norm(np.ptp(point_mm, axis=0)))
    try:
        found = best_guess(
            lambda count: _guesses(point_mm, normal, with_normal[draw(count, 2, len(with_normal), rng)], span_mm),
            lambda guesses: _residuals(guesses, jury),
            lambda residuals: mlesac_score(residuals, threshold_mm=threshold_mm, span_mm=span_mm),
            sample_size=2,
            threshold_mm=threshold_mm,
            most_guesses=MOST_GUESSES,
        )
    except ValueError as error:
        raise ReconError(f"no cylinder fits: {error}; are all normals parallel?") from None
    cylinder = Cylinder(found[:3], found[3:6], float(found[6]))
    return _refined(cylinder, point_mm, threshold_mm=threshold_mm)


def _guesses(point_mm: Points, normal: Points, rows: np.ndarray, span_mm: float) -> Guesses:
    """Return [point, axis, radius] of the cylinders that two points and normals fix; NaN where they fix none.

    The axis is at right angles to both normals; seen along it, the two lines along the normals cross in the centre.
    """
    p, q = point_mm[rows[:, 0]], point_mm[rows[:, 1]]
    n, m = normal[rows[:, 0]], normal[rows[:, 1]]
    across = np.cross(n, m)
    sine = np.linalg.norm(across, axis=1, keepdims=True)
    axis = np.divide(across, sine, out=np.full_like(across, np.nan), where=sine > SMALLEST_SINE)
    apart = q - p
    # p + s n = q + t m up to a move along the axis.
    s = (np.cross(apart, m) * axis).sum(1) / sine[:, 0].clip(SMALLEST_SINE)
    t = (np.cross(apart, n) * axis).sum(1) / sine[:, 0].clip(SMALLEST_SINE)
    # Both normals point outwards, or both inwards: s and t then have one sign.
    radius = np.where((s * t > 0) & (np.abs(s) < span_mm), 0.5 * np.abs(s + t), np.nan)
    return np.column_stack([p + s[:, None] * n, axis, radius])


def _residuals(guesses: Guesses, point_mm: Points) -> Residuals:
    centre, axis, radius = guesses[:, None, :3], guesses[:, None, 3:6], guesses[:, 6:]
    offset = point_mm[None] - centre
    along = (offset * axis).sum(2)
    return np.sqrt(np.maximum((offset**2).sum(2) - along**2, 0.0)) - radius


def _refined(cylinder: Cylinder, point_mm: Points, *, threshold_mm: float) -> Cylinder:
    """Fit the inliers, take the inliers of that, and so on until they stay (each round lowers Σ min(d², threshold²))."""
    inlier = np.abs(cylinder.distance_mm(point_mm)) <= threshold_mm
    for _ in range(REFINEMENTS):
        if inlier.sum() < 5:
            break
        cylinder = least_squares_cylinder(point_mm[inlier], start=cylinder)
        agreeing = np.abs(cylinder.distance_mm(point_mm)) <= threshold_mm
        if (agreeing == inlier).all():
            break
        inlier = agreeing
    return cylinder


def least_squares_cylinder(point_mm: Points, *, start: Cylinder) -> Cylinder:
    """Return the cylinder with the least sum of squared distances of the points to its surface (Gauss–Newton).

    Five unknowns: the axis moves and tilts in the two directions across it, and the radius.
    """
    cylinder = start
    size_mm = float(np.linalg.norm(np.ptp(point_mm, axis=0)))
    for _ in range(MOST_STEPS):
        first, second = _across(cylinder.axis)
        # About the middle of the points, tilt and shift of the axis are nearly independent.
        middle = float((point_mm.mean(axis=0) - cylinder.point_mm) @ cylinder.axis)
        cylinder = Cylinder(cylinder.point_mm + middle * cylinder.axis, cylinder.axis, cylinder.radius_mm)
        offset = point_mm - cylinder.point_mm
        x, y, along = (offset @ axis for axis in (first, second, cylinder.axis))
        distance = np.hypot(x, y)
        # A point on the axis has no direction; it then pulls at nothing but the radius.
        u, v = x / np.maximum(distance, np.finfo(float).tiny), y / np.maximum(distance, np.finfo(float).tiny)
        slopes = np.stack([-u, -v, -u * along, -v * along, -np.ones_like(u)])
        step, *_ = np.linalg.lstsq(slopes @ slopes.T, -slopes @ (distance - cylinder.radius_mm), rcond=None)
        axis = cylinder.axis + step[2] * first + step[3] * second
        cylinder = Cylinder(
            cylinder.point_mm + step[0] * first + step[1] * second,
            axis / np.linalg.norm(axis),
            cylinder.radius_mm + float(step[4]),
        )
        if max(np.abs(step[[0, 1, 4]]).max(), np.abs(step[2:4]).max() * size_mm) < SETTLED * size_mm:
            break
    return cylinder


def _across(axis: Float64[np.ndarray, " 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors at right angles to the axis and to each other."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    first = np.cross(axis, other)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)
