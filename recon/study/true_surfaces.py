"""Surfaces whose depth and normals are known in closed form, for the benchmark of integration.

Each is a depth z(x, y) over the square |x|, |y| ≤ 1, its slopes, and the mask on which it is seen; the unit is half the square's
side. Seen in perspective, the same surface stands before a pinhole, and each pixel's ray is followed to it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

Field = Float64[np.ndarray, "rows cols"]
Slopes = tuple[Field, Field]

BALL_RADIUS, CAP_RADIUS = 1.0, 0.9
RIPPLE_HEIGHT, RIPPLE_WAVES = 0.05, 4.0
TENT_SLOPE = 0.6
VASE_BODY, VASE_SWING, VASE_WAVE, VASE_SHARE = 0.45, 0.15, 3.0, 0.97
FLAP_SLOPE = 0.5


@dataclass(frozen=True, slots=True)
class TrueSurface:
    """One surface: its depth away from the camera, the slopes of depth, and where it is seen."""

    name: str
    depth: Callable[[Field, Field], Field]
    slopes: Callable[[Field, Field], Slopes]
    seen: Callable[[Field, Field], Bool[np.ndarray, "rows cols"]]


def _everywhere(x: Field, _: Field) -> Bool[np.ndarray, "rows cols"]:
    return np.ones(x.shape, bool)


def _in_cap(x: Field, y: Field) -> Bool[np.ndarray, "rows cols"]:
    return x**2 + y**2 < CAP_RADIUS**2


def _ball(x: Field, y: Field) -> Field:
    return -np.sqrt(np.maximum(BALL_RADIUS**2 - x**2 - y**2, 1e-12))


def _ball_slopes(x: Field, y: Field) -> Slopes:
    return -x / _ball(x, y), -y / _ball(x, y)


def _ripples(x: Field, y: Field) -> Field:
    wave = 2 * np.pi * RIPPLE_WAVES / 2
    return RIPPLE_HEIGHT * np.sin(wave * x) * np.cos(wave * y)


def _ripple_slopes(x: Field, y: Field) -> Slopes:
    wave = 2 * np.pi * RIPPLE_WAVES / 2
    return (
        RIPPLE_HEIGHT * wave * np.cos(wave * x) * np.cos(wave * y),
        -RIPPLE_HEIGHT * wave * np.sin(wave * x) * np.sin(wave * y),
    )


# Three Gaussian hills: height, place and width.
HILLS = ((-0.5, -0.3, -0.2, 0.30), (-0.35, 0.4, 0.35, 0.22), (0.25, 0.35, -0.45, 0.25))


def _hills(x: Field, y: Field) -> Field:
    return sum(a * np.exp(-((x - p) ** 2 + (y - q) ** 2) / (2 * s**2)) for a, p, q, s in HILLS) + 0 * x


def _hill_slopes(x: Field, y: Field) -> Slopes:
    along_x, along_y = np.zeros_like(x), np.zeros_like(x)
    for a, p, q, s in HILLS:
        hill = a * np.exp(-((x - p) ** 2 + (y - q) ** 2) / (2 * s**2)) / s**2
        along_x -= hill * (x - p)
        along_y -= hill * (y - q)
    return along_x, along_y


# The crease runs askew to the pixels.
RIDGE = (np.cos(0.3), np.sin(0.3))


def _tent(x: Field, y: Field) -> Field:
    return TENT_SLOPE * np.abs(RIDGE[0] * x + RIDGE[1] * y)


def _tent_slopes(x: Field, y: Field) -> Slopes:
    side = np.sign(RIDGE[0] * x + RIDGE[1] * y)
    return TENT_SLOPE * RIDGE[0] * side, TENT_SLOPE * RIDGE[1] * side


def _vase_radius(y: Field) -> tuple[Field, Field]:
    return VASE_BODY + VASE_SWING * np.sin(VASE_WAVE * y), VASE_SWING * VASE_WAVE * np.cos(VASE_WAVE * y)


def _on_vase(x: Field, y: Field) -> Bool[np.ndarray, "rows cols"]:
    return np.abs(x) < VASE_SHARE * _vase_radius(y)[0]


def _vase(x: Field, y: Field) -> Field:
    """A turned body, seen almost to its outline, where it is steep."""
    return -np.sqrt(np.maximum(_vase_radius(y)[0] ** 2 - x**2, 1e-12))


def _vase_slopes(x: Field, y: Field) -> Slopes:
    radius, change = _vase_radius(y)
    return -x / _vase(x, y), radius * change / _vase(x, y)


def _on_flap(x: Field, y: Field) -> Bool[np.ndarray, "rows cols"]:
    return (x > 0) & (y > 0)


def _flap(x: Field, y: Field) -> Field:
    """A sheet cut along half a line, one side of the cut folded away: the jump grows from nothing."""
    return np.where(_on_flap(x, y), FLAP_SLOPE * y, 0.0)


def _flap_slopes(x: Field, y: Field) -> Slopes:
    return np.zeros_like(x), np.where(_on_flap(x, y), FLAP_SLOPE, 0.0)


SURFACES = (
    TrueSurface("ball cap", _ball, _ball_slopes, _in_cap),
    TrueSurface("hills", _hills, _hill_slopes, _everywhere),
    TrueSurface("ripples", _ripples, _ripple_slopes, _everywhere),
    TrueSurface("tent with a crease", _tent, _tent_slopes, _everywhere),
    TrueSurface("vase", _vase, _vase_slopes, _on_vase),
    TrueSurface("cut sheet", _flap, _flap_slopes, _everywhere),
)


# The pinhole of the view in perspective stands so far before the plane z = 0.
PINHOLE = 4.0
MOST_STEPS = 200
MET = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A surface as it is seen: its depth along each pixel's ray, unit normal, and the pixels that see it.

    In perspective rays leave the pinhole along ``direction``, whose z is 1; seen in parallel, they leave ``origin`` along z.
    """

    depth: Field
    normal: Float64[np.ndarray, "rows cols 3"]
    mask: Bool[np.ndarray, "rows cols"]
    origin: Float64[np.ndarray, "rows cols 3"]
    direction: Float64[np.ndarray, "rows cols 3"]


def seen_in_parallel(surface: TrueSurface, size: int) -> View:
    """Return the surface on ``size`` × ``size`` pixels along z."""
    x, y = grid_of(size)
    along = np.broadcast_to([0.0, 0.0, 1.0], (*x.shape, 3))
    origin = np.stack([x, y, np.zeros_like(x)], axis=2)
    return View(surface.depth(x, y), normals_of(*surface.slopes(x, y)), surface.seen(x, y), origin, along)


def seen_in_perspective(surface: TrueSurface, size: int) -> View:
    """Return the surface on ``size`` × ``size`` pixels from a pinhole, whose rays cross z = 0 where the pixels are.

    Each ray is followed by repeated substitution; pixels for which that does not settle are left out.
    """
    x, y = grid_of(size)
    direction = np.stack([x / PINHOLE, y / PINHOLE, np.ones_like(x)], axis=2)
    depth = np.full(x.shape, PINHOLE)
    for _ in range(MOST_STEPS):
        before = depth
        depth = PINHOLE + surface.depth(depth * direction[..., 0], depth * direction[..., 1])
    at_x, at_y = depth * direction[..., 0], depth * direction[..., 1]
    mask = surface.seen(at_x, at_y) & (np.abs(depth - before) < MET)
    return View(depth, normals_of(*surface.slopes(at_x, at_y)), mask, np.zeros(direction.shape), direction)


def with_noise(view: View, *, sd_rad: float, rng: np.random.Generator) -> View:
    """Return the view with Gaussian noise on both tilts of every normal."""
    noisy = view.normal + sd_rad * rng.standard_normal(view.normal.shape)
    return replace(view, normal=noisy / np.linalg.norm(noisy, axis=2, keepdims=True))


def grid_of(size: int) -> tuple[Field, Field]:
    """Return the places of ``size`` × ``size`` pixels' centres in the square."""
    places = (np.arange(size) + 0.5) * 2 / size - 1
    x, y = np.meshgrid(places, places)
    return x, y


def normals_of(slope_x: Field, slope_y: Field) -> Float64[np.ndarray, "rows cols 3"]:
    """Return unit normals (−∂z/∂x, −∂z/∂y, 1), away from the camera."""
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=2)
    return normal / np.linalg.norm(normal, axis=2, keepdims=True)
