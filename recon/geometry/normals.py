"""Surface normals from the two directions of light at an entry point, by two routes that must agree.

``U`` is the direction of the path in the liquid and ``V`` that in air, both towards the object; the object refracts them onto the
same path inside, so their tangential parts obey n_liquid U_t = n_air V_t whatever the object's index.
"""

import numpy as np
from jaxtyping import Float64

from recon.geometry.light_paths import LightPaths

Directions = Float64[np.ndarray, "rays 3"]
Angles = Float64[np.ndarray, " rays"]


def normals_from_paths(liquid: Directions, air: Directions, *, n_liquid: float, n_air: float) -> Directions:
    """Return unit normals pointing into the liquid: Eq. 3, n ∝ n_liquid U − n_air V.

    The difference has no tangential part (Snell's law in vector form). Light arrives from the liquid, so the
    normal that points into the liquid has n·U < 0.
    """
    along = n_liquid * liquid - n_air * air
    length = np.linalg.norm(along, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = along / length
    return normal * -np.sign((normal * liquid).sum(1, keepdims=True))


def incidence_from_deviation(deviation_rad: Angles, *, n_liquid: float, n_air: float) -> Angles:
    """Recover the incidence angle in the liquid, Eq. 1; negative where the liquid is the thinner medium.

    Examples
    --------
    Light at 30° in water comes from 41.68° in air (Snell), a deviation of 11.68°:

    >>> import numpy as np
    >>> air = np.arcsin(1.33 * np.sin(np.radians(30.0)))
    >>> theta = incidence_from_deviation(np.array([air - np.radians(30.0)]), n_liquid=1.33, n_air=1.0)
    >>> round(float(np.degrees(theta[0])), 6)
    30.0
    """
    # arctan, not arctan2: with the thinner medium in the tank the denominator is
    # negative, and arctan2's extra half turn would flip the normal of Eq. 2.
    return np.arctan(n_air * np.sin(deviation_rad) / (n_liquid - n_air * np.cos(deviation_rad)))


def normals_from_angles(liquid: Directions, air: Directions, *, n_liquid: float, n_air: float) -> Directions:
    """Return unit normals pointing into the liquid as the paper writes them: Eq. 1, then Eq. 2.

    Eq. 2 turns U about V×U by the incidence angle (Rodrigues) and gives the normal's line; NaN for parallel paths.
    """
    axis = np.cross(air, liquid)
    sine = np.linalg.norm(axis, axis=1)
    deviation = np.arctan2(sine, (liquid * air).sum(1))
    incidence = incidence_from_deviation(deviation, n_liquid=n_liquid, n_air=n_air)
    with np.errstate(invalid="ignore", divide="ignore"):
        axis = axis / sine[:, None]
    # U is at right angles to the axis, so Rodrigues' third term vanishes.
    turned = np.cos(incidence)[:, None] * liquid + np.sin(incidence)[:, None] * np.cross(axis, liquid)
    return turned * -np.sign((turned * liquid).sum(1, keepdims=True))


def normal_sd_rad(liquid: LightPaths, air: LightPaths, *, n_liquid: float, n_air: float) -> Angles:
    """Return the standard deviation of the normal's direction: root of the summed variances of its two tilts."""
    along = n_liquid * liquid.direction - n_air * air.direction
    length = np.linalg.norm(along, axis=1)
    normal = along / length[:, None]
    variance = np.zeros(len(length))
    for paths, n_medium in ((liquid, n_liquid), (air, n_air)):
        facing = (normal * paths.direction).sum(axis=1)
        scale = (n_medium / paths.baseline_mm) ** 2
        for noise in (paths.near_noise, paths.far_noise):
            for axis, sd in zip(noise.axes.T, noise.sd_mm.T, strict=True):
                # What of a unit shift turns the path, and what of that turns the normal: the parts across either.
                along = paths.direction @ axis
                variance += scale * sd**2 * (1 - along**2 - (normal @ axis - facing * along) ** 2)
    return np.sqrt(np.maximum(variance, 0.0)) / length
