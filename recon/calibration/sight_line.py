"""From a direction in which the camera looks to the place of the screen that it sees: the exact path.

Light is followed from the camera: straight in air, bent at the liquid's surface (a plane), bent again at the cover glass
(a sheet parallel to the pixels), to the plane of the pixels. Snell's law in vector form keeps the tangential part of n·d
(Born and Wolf, *Principles of Optics*, 3.2.2).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Vectors = Float64[np.ndarray, "rays 3"]


@dataclass(frozen=True, slots=True, eq=False)
class PanelPose:
    """Where the plane of the display's pixels stands in the camera's frame.

    ``rotation``'s columns are the screen's x (right), y (down) and z (into the screen) axes; ``centre_mm`` the panel's centre.
    """

    rotation: Float64[np.ndarray, "3 3"]
    centre_mm: Float64[np.ndarray, " 3"]


@dataclass(frozen=True, slots=True, eq=False)
class LiquidPlane:
    """The liquid's flat surface: points X with ``down`` · X = ``distance_mm``; ``down`` points into the liquid, length 1."""

    down: Float64[np.ndarray, " 3"]
    distance_mm: float


def panel_places(
    ray: Vectors,
    pose: PanelPose,
    *,
    n_air: float,
    liquid: LiquidPlane | None = None,
    n_liquid: float = 1.0,
    glass_mm: float = 0.0,
    n_glass: float = 1.0,
) -> Float64[np.ndarray, "rays 2"]:
    """Return the screen coordinates (x right, y down, mm) that rays from the camera's centre end at.

    ``n_liquid`` counts only with a ``liquid``. Rays that do not run into the screen give NaN.
    """
    if liquid is None:
        return places_from(np.zeros_like(ray), ray, pose, n_medium=n_air, glass_mm=glass_mm, n_glass=n_glass)
    start_mm, direction = under_surface(ray, liquid, n_air=n_air, n_liquid=n_liquid)
    return places_from(start_mm, direction, pose, n_medium=n_liquid, glass_mm=glass_mm, n_glass=n_glass)


def under_surface(ray: Vectors, liquid: LiquidPlane, *, n_air: float, n_liquid: float) -> tuple[Vectors, Vectors]:
    """Return where rays from the camera's centre meet the liquid (mm; NaN where they do not), and their direction in it."""
    slope = ray @ liquid.down
    with np.errstate(divide="ignore", invalid="ignore"):
        start_mm = ray * np.where(slope > 0, liquid.distance_mm / slope, np.nan)[:, None]
    return start_mm, bent(ray, liquid.down, n_from=n_air, n_to=n_liquid)


def places_from(
    start_mm: Vectors,
    direction: Vectors,
    pose: PanelPose,
    *,
    n_medium: float,
    glass_mm: float = 0.0,
    n_glass: float = 1.0,
) -> Float64[np.ndarray, "rays 2"]:
    """Return the screen coordinates that rays in the medium before the panel end at; NaN where they miss it."""
    inside = direction
    if glass_mm != 0:
        inside = bent(direction, pose.rotation[:, 2], n_from=n_medium, n_to=n_glass)
    return upright_places(
        (start_mm - pose.centre_mm) @ pose.rotation,
        direction @ pose.rotation,
        inside @ pose.rotation,
        glass_mm=glass_mm,
    )


def upright_places(
    start_mm: Vectors, direction: Vectors, inside: Vectors, *, glass_mm: float
) -> Float64[np.ndarray, "rays 2"]:
    """Return where rays given in the screen's own frame meet its plane z = 0; NaN where they miss it.

    ``inside`` is their direction in the cover glass, which begins at z = −``glass_mm``.
    """
    slope = direction[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(slope > 0, (-glass_mm - start_mm[:, 2]) / slope, np.nan)
    place = start_mm[:, :2] + along[:, None] * direction[:, :2]
    if glass_mm != 0:
        place = place + inside[:, :2] * (glass_mm / inside[:, 2])[:, None]
    return place


def bent(direction: Vectors, towards: Float64[np.ndarray, "*rays 3"], *, n_from: float, n_to: float) -> Vectors:
    """Return unit directions after a surface whose unit normals ``towards`` (one, or one a ray) point along the light.

    NaN beyond the critical angle.
    """
    ratio = n_from / n_to
    cosine = (direction * towards).sum(axis=1)
    with np.errstate(invalid="ignore"):
        cosine_after = np.sqrt(1 - ratio**2 * (1 - cosine**2))
    return ratio * direction + (cosine_after - ratio * cosine)[:, None] * towards
