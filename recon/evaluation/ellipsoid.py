"""Distance to a known ellipsoid, for scenes whose object is one."""

import numpy as np
from jaxtyping import Float64


def ellipsoid_distance_mm(
    point_mm: Float64[np.ndarray, "points 3"], semi_axes_mm: tuple[float, float, float]
) -> Float64[np.ndarray, " points"]:
    """Return the signed distance to x²/a² + y²/b² + z²/c² = 1, to first order: f / |∇f|; positive outside.

    The error of this is of the order of the squared distance over the radius of curvature (Taubin 1991).

    Examples
    --------
    >>> ellipsoid_distance_mm(np.array([[0.0, 0.0, 5.01]]), (12.5, 12.5, 5.0)).round(4)
    array([0.01])
    """
    axes = np.array(semi_axes_mm)
    level = ((point_mm / axes) ** 2).sum(1) - 1
    slope = np.linalg.norm(2 * point_mm / axes**2, axis=1)
    return np.divide(level, slope, out=np.full(len(level), np.nan), where=slope > 0)
