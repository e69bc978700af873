"""How sure points and normals of an object would be, before any photo is taken: the covariances of a reconstruction, for a guess.

The guess is a piece of glass, flat towards the camera, whose display side is given as points and normals. Light from the camera
enters the flat face, meets each of the points, and leaves into liquid or air; where it meets the two displays is what a capture
would measure.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from recon.geometry.entry_point import entry_points
from recon.geometry.flat_face import inner_directions
from recon.geometry.light_paths import LightPaths, light_paths
from recon.geometry.normals import normal_sd_rad
from recon.sessions.manifest import DisplayPanel, Pose

Vectors = Float64[np.ndarray, "points 3"]
Vector = Float64[np.ndarray, " 3"]
GOLDEN_TURN = np.pi * (3 - np.sqrt(5))
# As the reconstruction's own test: less sure, the two paths count as parallel.
ANGLE_SIGMA = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Guess:
    """The display side of an object: points, and unit normals that point towards the display; ``n`` is its index."""

    point_mm: Vectors
    normal: Vectors
    n: float


@dataclass(frozen=True, slots=True)
class Indices:
    """Indices of the liquid and of air."""

    n_liquid: float
    n_air: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a capture would give: the share of the guess's points that become points, and medians of their standard deviations.

    A point is lost where its light misses the panel in some set, is totally reflected, or comes by paths too nearly parallel.
    The standard deviations are those of single pixels, before the surface is fused. NaN where every point is lost.
    """

    share: float
    off_panel_share: float
    point_sd_mm: float
    normal_sd_rad: float
    angle_rad: float


def dome(*, apex_mm: Vector, towards_display: Vector, radius_mm: float, n: float, points: int = 400) -> Guess:
    """Return half a ball whose apex is nearest the display, up to 60° from it."""
    number = np.arange(points) + 0.5
    cosine = 1 - 0.5 * number / points
    sine, turn = np.sqrt(1 - cosine**2), GOLDEN_TURN * number
    first, second = _across(towards_display)
    normal = (
        np.outer(cosine, towards_display) + np.outer(sine * np.cos(turn), first) + np.outer(sine * np.sin(turn), second)
    )
    return Guess(apex_mm + radius_mm * (normal - towards_display), normal, n)


def facet(
    *, middle_mm: Vector, towards_display: Vector, size_mm: float, tilt_rad: float, n: float, points: int = 400
) -> Guess:
    """Return a round plane of diameter ``size_mm``, its normal tilted from the direction of the display."""
    first, second = _across(towards_display)
    normal = np.cos(tilt_rad) * towards_display + np.sin(tilt_rad) * first
    along = np.cos(tilt_rad) * first - np.sin(tilt_rad) * towards_display
    number = np.arange(points) + 0.5
    radius, turn = 0.5 * size_mm * np.sqrt(number / points), GOLDEN_TURN * number
    point = middle_mm + np.outer(radius * np.cos(turn), along) + np.outer(radius * np.sin(turn), second)
    return Guess(point, np.tile(normal, (points, 1)), n)


def predicted(
    guess: Guess,
    poses: tuple[Pose, Pose],
    panel: DisplayPanel,
    *,
    camera_mm: Vector | None,
    towards_display: Vector,
    indices: Indices,
    place_sd_px: float,
) -> Prediction:
    """Return what a capture of the guess would give.

    Parameters
    ----------
    poses, panel : where the display would stand, and what it is.
    camera_mm : where the camera is; None for one far away.
    towards_display : unit vector at right angles to the object's flat face.
    place_sd_px : expected standard deviation of a correspondence, in device pixels.
    """
    sight = np.tile(towards_display, (len(guess.point_mm), 1)) if camera_mm is None else guess.point_mm - camera_mm
    sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    inside = inner_directions(sight, face_normal=towards_display, n_object=guess.n, n_air=indices.n_air)
    paths, on_panel = [], np.ones(len(sight), dtype=bool)
    passes = np.ones(len(sight), dtype=bool)
    for n_medium in (indices.n_liquid, indices.n_air):
        outside = _refracted(inside, guess.normal, guess.n / n_medium)
        passes &= np.isfinite(outside).all(axis=1)
        made, hit = _paths(guess.point_mm, outside, poses, panel, n_medium=n_medium, sd_mm=place_sd_px * panel.pitch_mm)
        paths.append(made)
        on_panel &= hit
    liquid, air = paths
    points = entry_points(liquid, air, weighted=True)
    with np.errstate(invalid="ignore"):
        kept = passes & on_panel & (points.angle_rad > ANGLE_SIGMA * points.angle_sd_rad)
    if not kept.any():
        return Prediction(0.0, float(np.mean(passes & ~on_panel)), np.nan, np.nan, np.nan)
    sd_mm = np.sqrt(np.trace(points.covariance[kept], axis1=1, axis2=2))
    turn = normal_sd_rad(liquid, air, n_liquid=indices.n_liquid, n_air=indices.n_air)[kept]
    return Prediction(
        float(kept.mean()),
        float(np.mean(passes & ~on_panel)),
        float(np.median(sd_mm)),
        float(np.median(turn)),
        float(np.median(points.angle_rad[kept])),
    )


def _across(direction: Vector) -> tuple[np.ndarray, np.ndarray]:
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)


def _refracted(inside: Vectors, normal: Vectors, ratio: float) -> Vectors:
    """Return directions after a surface (Snell's law in vector form), NaN beyond the critical angle."""
    along = (inside * normal).sum(axis=1, keepdims=True)
    across = ratio * (inside - along * normal)
    rest = 1 - (across**2).sum(axis=1, keepdims=True)
    return across + np.sqrt(np.where((rest > 0) & (along > 0), rest, np.nan)) * normal


def _paths(
    point_mm: Vectors, outside: Vectors, poses: tuple[Pose, Pose], panel: DisplayPanel, *, n_medium: float, sd_mm: float
) -> tuple[LightPaths, Bool[np.ndarray, " points"]]:
    """Return the paths that would be measured, and which of them lie on the panel at both positions.

    Cover glass shifts both places of a path alike, which changes neither its direction nor its uncertainty.
    """
    screens, hit = [], np.ones(len(point_mm), dtype=bool)
    half = 0.5 * panel.pitch_mm * np.array([panel.columns, panel.rows])
    for pose in poses:
        frame = pose.world_from_screen()
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((frame[:3, 3] - point_mm) @ frame[:3, 2]) / (outside @ frame[:3, 2])
            place = (point_mm + distance[:, None] * outside - frame[:3, 3]) @ frame[:3, :2]
            hit &= (distance > 0) & (np.abs(place) < half).all(axis=1)
        screens.append(place)
    sd = np.full((len(point_mm), 2), sd_mm)
    return light_paths((screens[0], screens[1]), (sd, sd), poses, cover_glass=None, n_medium=n_medium), hit
