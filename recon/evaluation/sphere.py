"""A sphere: fitted by geometric least squares, and the errors against it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.errors import ReconError
from recon.evaluation.consensus import draw, judges
from recon.evaluation.spread import Spread, angle_between_rad, spread_of, unit

Points = Float64[np.ndarray, "points 3"]
PerPoint = Float64[np.ndarray, " points"]

MOST_STEPS = 50
# Gauss–Newton stops when a step moves the sphere by less than this share of its radius.
SETTLED = 1e-12
NORMAL_CONSISTENT_MAD = 1.4826
TUKEY_WIDTH_SD = 4.685  # 95 % efficient for Gaussian noise (Holland and Welsch 1977)
# With 40 % outliers, 200 draws of four points miss a clean one with a chance of 1e-12.
START_DRAWS = 200


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """Centre and radius."""

    centre_mm: Float64[np.ndarray, " 3"]
    radius_mm: float

    def distance_mm(self, point_mm: Points) -> Float64[np.ndarray, " points"]:
        """Return signed distances to the surface, positive outside."""
        return np.linalg.norm(point_mm - self.centre_mm, axis=1) - self.radius_mm


@dataclass(frozen=True, slots=True, eq=False)
class SphereFit:
    """A sphere, and the errors of all points against it."""

    sphere: Sphere
    position_mm: Spread
    normal_rad: Spread


def least_squares_sphere(point_mm: Points) -> Sphere:
    """Return the sphere with the least sum of squared distances of the points to its surface (Gauss–Newton)."""
    return _descend(_algebraic(point_mm), point_mm, weights=lambda residual: np.ones_like(residual))


def robust_sphere(point_mm: Points, *, rng: np.random.Generator) -> Sphere:
    """Fit a sphere that up to about 40 % gross outliers do not move.

    Starts from the sphere through four points with the least median residual of many draws (Rousseeuw 1984), then
    reweights least squares with Tukey's biweight, whose scale comes from the residuals themselves.
    """
    _refuse_too_few(point_mm)
    return _descend(_least_median(point_mm, rng), point_mm, weights=_tukey)


def fit_sphere(point_mm: Points, normal: Points, *, rng: np.random.Generator) -> SphereFit:
    """Fit a sphere and judge all points: distance to the centre less the radius, and angle of radius and normal.

    A hollow, whose normals point at the centre, is judged by the inward radius.
    """
    sphere = robust_sphere(point_mm, rng=rng)
    radial = unit(point_mm - sphere.centre_mm)
    if np.nansum(radial * normal) < 0:
        radial = -radial
    return SphereFit(sphere, spread_of(sphere.distance_mm(point_mm)), spread_of(angle_between_rad(normal, radial)))


def _refuse_too_few(point_mm: Points) -> None:
    if len(point_mm) < 4:
        raise ReconError(f"a sphere needs 4 points, {len(point_mm)} given")


def _algebraic(point_mm: Points) -> Sphere:
    """Solve |x|² = 2 c·x + (r² − |c|²) for the centre c, about the centroid (Kåsa's fit)."""
    _refuse_too_few(point_mm)
    middle = point_mm.mean(axis=0)
    local = point_mm - middle
    scale = np.abs(local).max()
    scale = scale if scale > 0 else 1.0
    local = local / scale
    unknowns = np.column_stack([2 * local, np.ones(len(local))])
    solution, _, rank, _ = np.linalg.lstsq(unknowns, (local**2).sum(1), rcond=1e-10)
    if rank < 4:
        raise ReconError("no sphere fits: the points lie in one plane")
    centre = solution[:3]
    return Sphere(middle + scale * centre, float(scale * np.sqrt(solution[3] + centre @ centre)))


def _descend(sphere: Sphere, point_mm: Points, *, weights: Callable[[PerPoint], PerPoint]) -> Sphere:
    """Minimise the weighted squared distances by Gauss–Newton; residual r_k = |x_k − c| − R."""
    for _ in range(MOST_STEPS):
        residual = sphere.distance_mm(point_mm)
        weight = weights(residual)
        slopes = np.column_stack([-unit(point_mm - sphere.centre_mm), -np.ones(len(point_mm))])
        slopes[~np.isfinite(slopes).all(axis=1)] = 0.0  # a point in the centre has no direction
        weighted = slopes * weight[:, None]
        try:
            step = -np.linalg.solve(weighted.T @ slopes, weighted.T @ residual)
        except np.linalg.LinAlgError:
            raise ReconError("no sphere fits: the points lie in one plane") from None
        sphere = Sphere(sphere.centre_mm + step[:3], sphere.radius_mm + float(step[3]))
        if np.abs(step).max() < SETTLED * abs(sphere.radius_mm):
            break
    return sphere


def _least_median(point_mm: Points, rng: np.random.Generator) -> Sphere:
    """Return the sphere through four drawn points with the smallest median distance to a part of the points."""
    jury = judges(point_mm, rng)
    best, least = None, np.inf
    for rows in draw(START_DRAWS, 4, len(point_mm), rng):
        try:
            sphere = _algebraic(point_mm[rows])
        except ReconError:
            continue
        median = float(np.median(np.abs(sphere.distance_mm(jury))))
        if median < least:
            best, least = sphere, median
    return best if best is not None else _algebraic(point_mm)


def _tukey(residual: PerPoint) -> PerPoint:
    """Return Tukey's biweight; where the residuals are rounding only, all count."""
    scale = NORMAL_CONSISTENT_MAD * float(np.median(np.abs(residual)))
    if scale == 0:
        return np.ones_like(residual)
    share = np.minimum(np.abs(residual) / (TUKEY_WIDTH_SD * scale), 1.0)
    return (1 - share**2) ** 2
