"""Planes: fitted by RANSAC, and the errors against them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from recon.errors import ReconError
from recon.evaluation.consensus import best_guess, draw, judges, ransac_score
from recon.evaluation.published import THRESHOLD_MM
from recon.evaluation.spread import Spread, angle_between_rad, spread_of, unit

Points = Float64[np.ndarray, "points 3"]

MOST_GUESSES = 4000
REFINEMENTS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The points x with ``normal`` · x = ``offset_mm``."""

    normal: Float64[np.ndarray, " 3"]
    offset_mm: float

    def distance_mm(self, point_mm: Points) -> Float64[np.ndarray, " points"]:
        """Return signed distances, positive on the normal's side."""
        return point_mm @ self.normal - self.offset_mm


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A plane, the share of points within the threshold, and the errors of all points against it."""

    plane: Plane
    inlier: Bool[np.ndarray, " points"]
    position_mm: Spread
    normal_rad: Spread

    @property
    def inlier_share(self) -> float:
        """Share of all points within the threshold."""
        return float(self.inlier.mean())


def least_squares_plane(point_mm: Points) -> Plane:
    """Return the plane with the least sum of squared distances, through the centroid."""
    if len(point_mm) < 3:
        raise ReconError(f"a plane needs 3 points, {len(point_mm)} given")
    centre = point_mm.mean(axis=0)
    normal = np.linalg.eigh(np.cov((point_mm - centre).T))[1][:, 0]
    return Plane(normal, float(normal @ centre))


def ransac_plane(point_mm: Points, *, threshold_mm: float, rng: np.random.Generator) -> Plane:
    """Return the plane that most points lie within ``threshold_mm`` of, refined by least squares over those."""
    if len(point_mm) < 3:
        raise ReconError(f"a plane needs 3 points, {len(point_mm)} given")
    jury = judges(point_mm, rng)

    def guess(count: int) -> Float64[np.ndarray, "count 4"]:
        a, b, c = np.moveaxis(point_mm[draw(count, 3, len(point_mm), rng)], 1, 0)
        normal = unit(np.cross(b - a, c - a))
        return np.column_stack([normal, (normal * a).sum(1)])

    try:
        found = best_guess(
            guess,
            lambda guesses: guesses[:, :3] @ jury.T - guesses[:, 3:],
            lambda residuals: ransac_score(residuals, threshold_mm=threshold_mm),
            sample_size=3,
            threshold_mm=threshold_mm,
            most_guesses=MOST_GUESSES,
        )
    except ValueError as error:
        raise ReconError(f"no plane fits: {error}; do all points lie on one line?") from None
    return _refined(Plane(found[:3], float(found[3])), point_mm, threshold_mm=threshold_mm)


def _refined(plane: Plane, point_mm: Points, *, threshold_mm: float) -> Plane:
    """Fit the inliers, take the inliers of that, and so on until they stay (each round lowers Σ min(d², threshold²))."""
    inlier = np.abs(plane.distance_mm(point_mm)) <= threshold_mm
    for _ in range(REFINEMENTS):
        if inlier.sum() < 3:
            break
        plane = least_squares_plane(point_mm[inlier])
        agreeing = np.abs(plane.distance_mm(point_mm)) <= threshold_mm
        if (agreeing == inlier).all():
            break
        inlier = agreeing
    return plane


def fit_plane(
    point_mm: Points, normal: Points, *, rng: np.random.Generator, threshold_mm: float = THRESHOLD_MM
) -> PlaneFit:
    """Fit one plane and judge all points: their distance to it, and the angle of their normals to its normal."""
    plane = ransac_plane(point_mm, threshold_mm=threshold_mm, rng=rng)
    if np.nansum(normal @ plane.normal) < 0:
        plane = Plane(-plane.normal, -plane.offset_mm)
    distance_mm = plane.distance_mm(point_mm)
    return PlaneFit(
        plane=plane,
        inlier=np.abs(distance_mm) <= threshold_mm,
        position_mm=spread_of(distance_mm),
        normal_rad=spread_of(angle_between_rad(normal, np.broadcast_to(plane.normal, normal.shape))),
    )
