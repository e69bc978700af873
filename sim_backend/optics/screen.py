"""The display as the rays meet it: a plane of pixels, perhaps behind cover glass."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from sim_backend.optics.refraction import fresnel_transmission, refract

Vectors = Float64[np.ndarray, "rays 3"]
Numbers = Float64[np.ndarray, " rays"]
Vector = Float64[np.ndarray, " 3"]


@dataclass(frozen=True, slots=True, eq=False)
class ScreenPose:
    """Where the plane of the display's pixels stands; x_axis × y_axis points away from the viewer."""

    centre_mm: Vector
    x_axis: Vector
    y_axis: Vector

    def away(self) -> Vector:
        """Return the unit vector into the screen."""
        return np.cross(self.x_axis, self.y_axis)


@dataclass(frozen=True, slots=True, eq=False)
class ScreenHits:
    """Screen coordinates (origin at the panel's centre, x right, y down) and the light kept; NaN for a miss."""

    x_mm: Numbers
    y_mm: Numbers
    transmission: Numbers


def hit_screen(
    pose: ScreenPose,
    origin: Vectors,
    direction: Vectors,
    n: Numbers,
    *,
    glass_thickness_mm: float = 0.0,
    glass_n: float = 1.5,
) -> ScreenHits:
    """Follow rays of index ``n`` to the pixels, through the cover glass if there is one.

    A ray misses if it does not travel into the screen, or starts behind the glass. Far beyond the panel's edge it
    still has coordinates.
    """
    away = pose.away()
    slope = direction @ away
    forward = slope > 1e-12
    front = pose.centre_mm - glass_thickness_mm * away
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(forward, ((front - origin) @ away) / slope, np.nan)
    distance = np.where(distance >= 0, distance, np.nan)
    point = origin + distance[:, None] * direction - pose.centre_mm
    transmission = np.where(np.isfinite(distance), 1.0, 0.0)
    if glass_thickness_mm > 0:
        against = np.broadcast_to(-away, direction.shape)
        in_glass = np.full(len(n), glass_n)
        transmission = transmission * fresnel_transmission(np.clip(slope, 0.0, 1.0), n, in_glass)
        bent, reflected = refract(direction, against, n, in_glass)
        inward = np.where(forward & ~reflected, bent @ away, np.nan)
        point = point + bent * (glass_thickness_mm / inward)[:, None]
    return ScreenHits(point @ pose.x_axis, point @ pose.y_axis, transmission)
