"""Errors of a result where an assumption is wrong, and where it is not."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import binary_dilation

from recon.evaluation.spread import angle_between_rad
from recon.evaluation.truth import TruthStatus
from recon.maps import Maps
from recon.sessions.session import TRUTH_NAME

# What is wrong reaches a pixel whose centre sees another place on the display by so much, and its neighbours.
REACHED_PX = 0.05
# At a crease the true normal turns by so much from a pixel to the next; at the rim there is no next.
CREASE_RAD = np.radians(3.0)
NEIGHBOURHOOD = np.ones((3, 3), dtype=bool)

MaskMap = Bool[np.ndarray, "rows cols"]
ErrorMap = Float64[np.ndarray, "rows cols"]


@dataclass(frozen=True, slots=True, eq=False)
class Truths:
    """Points and normals to be found; ``judged`` pixels have them or see the object, ``reached`` ones what is wrong.

    NaN at judged pixels whose light enters the object again: no one point is their first. A point there is judged by its distance
    from the ball of ``radius_mm`` about the origin, and a normal against the ball's.
    """

    point_mm: Float64[np.ndarray, "rows cols 3"]
    normal: Float64[np.ndarray, "rows cols 3"]
    judged: MaskMap
    reached: MaskMap
    radius_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Errors of points and normals, NaN where there is none, and the points' standard deviations, NaN where none is stated."""

    point_mm: ErrorMap
    normal_deg: ErrorMap
    sd_mm: ErrorMap

    def found(self) -> MaskMap:
        """Return the judged pixels that have a point and a normal."""
        return np.isfinite(self.point_mm)

    def right(self, up_to: "RightUpTo") -> MaskMap:
        """Return the judged pixels whose point and normal are off by no more than that."""
        with np.errstate(invalid="ignore"):
            return (self.point_mm <= up_to.mm) & (self.normal_deg <= up_to.deg)


@dataclass(frozen=True, slots=True)
class RightUpTo:
    """The errors of point and normal up to which both count as right."""

    mm: float
    deg: float


def truths_of(session: Path, ideal: Path, *, about_creases: bool, radius_mm: float) -> Truths:
    """Read the truth of a session, and find what the wrong assumption reaches by that of the ``ideal`` one."""
    with np.load(session / TRUTH_NAME) as arrays, np.load(ideal / TRUTH_NAME) as quiet:
        point, normal, status = arrays["point_mm"], arrays["normal"], arrays["status"]
        wet = [name for name in arrays.files if name.endswith("_liquid")]
        moved = np.max([np.linalg.norm(arrays[name] - quiet[name], axis=2) for name in wet], axis=0)
    again = status == TruthStatus.RE_ENTERS
    judged = (status == TruthStatus.JUDGED) | again
    wrong = creased(normal) if about_creases else ~(moved < REACHED_PX)
    reached = again | binary_dilation(judged & wrong, NEIGHBOURHOOD)
    return Truths(point, normal, judged, reached & judged, radius_mm)


def creased(normal: Float64[np.ndarray, "rows cols 3"]) -> MaskMap:
    """Return the pixels whose normal differs from a neighbour's, or that have a neighbour without one.

    Examples
    --------
    >>> flat, steep = [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]
    >>> creased(np.array([[flat, flat, steep, steep]])).tolist()
    [[False, True, True, False]]
    """
    found = np.zeros(normal.shape[:2], dtype=bool)
    for axis in (0, 1):
        ahead = np.moveaxis(normal, axis, 0)
        first, second = ahead[:-1].reshape(-1, 3), ahead[1:].reshape(-1, 3)
        apart = ~(angle_between_rad(first, second) < CREASE_RAD).reshape(ahead[1:].shape[:2])
        apart &= np.isfinite(ahead[:-1]).all(axis=2) | np.isfinite(ahead[1:]).all(axis=2)
        marked = np.moveaxis(found, axis, 0)
        marked[:-1] |= apart
        marked[1:] |= apart
    return found


def errors_of(maps: Maps, truth: Truths, *, covered: bool) -> Errors:
    """Return the errors of a result: of the points that pixels measured themselves, and if asked of those covered too."""
    found = (maps.with_point() if covered else maps.valid()) & truth.judged & np.isfinite(maps.normal).all(axis=2)
    known = found & np.isfinite(truth.point_mm).all(axis=2)
    again = found & ~known
    point, normal = np.full(found.shape, np.nan), np.full(found.shape, np.nan)
    point[known] = np.linalg.norm(maps.point_mm[known] - truth.point_mm[known], axis=1)
    normal[known] = np.degrees(angle_between_rad(maps.normal[known], truth.normal[known]))
    distance = np.linalg.norm(maps.point_mm[again], axis=1)
    point[again] = np.abs(distance - truth.radius_mm)
    normal[again] = np.degrees(angle_between_rad(maps.normal[again], maps.point_mm[again] / distance[:, None]))
    return Errors(point, normal, np.where(found, maps.sd_mm.astype(np.float64), np.nan))
