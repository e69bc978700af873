"""What happens to a ray at a smooth boundary: Snell's law as vectors, total reflection, Fresnel transmission."""

import numpy as np
from jaxtyping import Bool, Float64

Vectors = Float64[np.ndarray, "rays 3"]
Numbers = Float64[np.ndarray, " rays"]


def facing(direction: Vectors, normal: Vectors) -> Vectors:
    """Return the normals of length 1, turned so that they look against the rays."""
    length = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    side = np.einsum("ij,ij->i", direction, normal)
    return normal * np.where(side > 0, -1 / length, 1 / length)[:, None]


def refract(
    direction: Vectors, normal: Vectors, n_from: Numbers, n_to: Numbers
) -> tuple[Vectors, Bool[np.ndarray, " rays"]]:
    """Bend rays at a boundary; where no light gets through, reflect them.

    Parameters
    ----------
    direction : unit vectors along the rays.
    normal : unit vectors against the rays (see :func:`facing`).
    n_from, n_to : refractive index on either side.

    Returns
    -------
    The unit directions after the boundary, and a mask of the rays that were totally reflected.

    Notes
    -----
    The tangential part of n·d is kept (Born and Wolf, *Principles of Optics*, 3.2.2):
    d' = (n₁/n₂) d + ((n₁/n₂) cos θ₁ − cos θ₂) N.
    """
    ratio = n_from / n_to
    cos_from = -np.einsum("ij,ij->i", direction, normal)
    square = 1 - ratio * ratio * (1 - cos_from * cos_from)
    reflected = square <= 0
    cos_to = np.sqrt(np.where(reflected, 0.0, square))
    scale = np.where(reflected, 1.0, ratio)
    push = np.where(reflected, 2 * cos_from, ratio * cos_from - cos_to)
    return direction * scale[:, None] + normal * push[:, None], reflected


def fresnel_transmission(cos_from: Numbers, n_from: Numbers, n_to: Numbers) -> Numbers:
    """Return the share of unpolarised light that passes a boundary; 0 beyond the critical angle.

    ``cos_from`` is the cosine of the angle of incidence, positive.
    """
    sine = n_from / n_to * np.sqrt(np.clip(1 - cos_from * cos_from, 0, 1))
    passes = sine < 1
    cos_to = np.sqrt(np.clip(1 - sine * sine, 0, 1))
    # Grazing rays between equal indices would divide nought by nought.
    cos_from = np.maximum(cos_from, 1e-12)
    across = (n_from * cos_from - n_to * cos_to) / (n_from * cos_from + n_to * cos_to)
    within = (n_to * cos_from - n_from * cos_to) / (n_to * cos_from + n_from * cos_to)
    return np.where(passes, 1 - 0.5 * (across * across + within * within), 0.0)
