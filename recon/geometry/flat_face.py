"""Thin objects with a flat face towards the camera: the light's direction inside them, exactly.

The thin-object method takes the visual ray for the path inside the object, that is, it leaves out the refraction at the
camera's side. Where that side is known to be flat (a plate, a lens on its back), Snell's law there gives the path
inside, and with it an exact normal on the display's side: Eq. 3 with the inner direction for U.
"""

import numpy as np
from jaxtyping import Float64

from recon.geometry.light_paths import LightPaths
from recon.sessions.manifest import FlatFace

Vectors = Float64[np.ndarray, "rays 3"]
Vector = Float64[np.ndarray, " 3"]


def inner_directions(visual_direction: Vectors, *, face_normal: Vector, n_object: float, n_air: float) -> Vectors:
    """Return the unit directions inside the object of light that leaves through the flat face as ``visual_direction``.

    All directions point from the display towards the camera. Parallel to the face, n_object D = n_air U (Snell's law in
    vector form); what is left of the unit length goes along the face's normal, on the side of U. The sign of
    ``face_normal`` does not matter.

    Examples
    --------
    Light that leaves glass of index 1.5 at 30° came at arcsin(0.5 / 1.5) = 19.47° (Snell):

    >>> ray = np.array([[np.sin(np.radians(30.0)), 0.0, -np.cos(np.radians(30.0))]])
    >>> inside = inner_directions(ray, face_normal=np.array([0.0, 0.0, 1.0]), n_object=1.5, n_air=1.0)
    >>> round(float(np.degrees(np.arcsin(inside[0, 0]))), 2)
    19.47
    """
    normal = face_normal / np.linalg.norm(face_normal)
    along = visual_direction @ normal
    parallel = (n_air / n_object) * (visual_direction - along[:, None] * normal)
    depth = np.sqrt(np.maximum(1 - (parallel**2).sum(1), 0.0))
    return parallel + (np.sign(along) * depth)[:, None] * normal


def points_on_face(
    point_mm: Vectors, visual_direction: Vectors, *, face_point_mm: Vector, face_normal: Vector
) -> Vectors:
    """Return where the visual rays through ``point_mm`` pierce the flat face; NaN for a ray that runs along it."""
    towards = visual_direction @ face_normal
    away = (face_point_mm - point_mm) @ face_normal
    distance = np.divide(away, towards, out=np.full(len(away), np.nan), where=towards != 0)
    return point_mm + distance[:, None] * visual_direction


def paths_inside(visual: LightPaths, face: FlatFace, *, n_object: float, n_air: float) -> LightPaths:
    """Return the paths inside the object of light that leaves its flat face along the visual rays.

    Each is the straight line through the visual ray's point on the face, in the inner direction; distances along it count as on
    the visual ray. Its uncertainty is taken over from the visual ray, though refraction makes that of its direction smaller.
    """
    normal, point_mm = np.array(face.normal), np.array(face.point_mm)
    on_face = points_on_face(visual.near_mm, visual.direction, face_point_mm=point_mm, face_normal=normal)
    inside = inner_directions(visual.direction, face_normal=normal, n_object=n_object, n_air=n_air)
    reach = ((on_face - visual.near_mm) * visual.direction).sum(axis=1, keepdims=True)
    near = on_face - reach * inside
    return LightPaths(
        near_mm=near,
        direction=inside,
        baseline_mm=visual.baseline_mm,
        near_noise=visual.near_noise,
        far_noise=visual.far_noise,
    )
