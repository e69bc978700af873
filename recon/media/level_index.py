"""The liquid's index from its own flat surface, where the camera sees the display past the object.

Each such pixel's two paths obey Snell's law at one plane: parallel to it, n_liquid U = n_air V. The plane's direction is one for
all pixels and is found with the index; it also takes up a tilt of all paths alike, such as a slipped display makes.
"""

import numpy as np
from jaxtyping import Float64, Int64

from recon.media.index_estimate import IndexEstimate, robust_weights, variance_by_bands

FEWEST_PIXELS = 300
ROUNDS = 8
BANDS_A_SIDE = 24

Directions = Float64[np.ndarray, "pixels 3"]


def index_from_level(
    liquid: Directions,
    air: Directions,
    *,
    upright: Float64[np.ndarray, " 3"],
    place: Float64[np.ndarray, "pixels 2"],
    n_air: float,
) -> IndexEstimate | None:
    """Return the index that makes one plane refract every pixel's path in air into its path in liquid.

    Parameters
    ----------
    liquid, air : unit directions of the two paths.
    upright : the surface's normal, roughly; it is refined.
    place : row and column of each pixel, from 0 to 1 over the photo.
    n_air : index of air.

    Notes
    -----
    With e at right angles to the upright m: n_liquid U·e − n_air V·e − κ m·(n_liquid U − n_air V) = 0, κ the tilt along e.
    Noise in U would pull the index towards 0 in least squares. So the equations are projected on V·e as a smooth function of the
    pixel's place, which has no noise (instrumental variables).
    """
    if len(liquid) < FEWEST_PIXELS:
        return None
    axes = _across(upright)
    smooth = _smooth_basis(place)
    along = (1.333 * liquid - n_air * air) @ upright
    count, zero = len(liquid), np.zeros(len(liquid))
    regressors, instruments, right = [], [], []
    for number, axis in enumerate(axes):
        tilts = [-along if other == number else zero for other in range(2)]
        sideways = n_air * (air @ axis)
        fitted = smooth @ np.linalg.lstsq(smooth, sideways, rcond=None)[0]
        regressors.append(np.column_stack([liquid @ axis, *tilts]))
        instruments.append(np.column_stack([fitted, *tilts]))
        right.append(sideways)
    a, z, b = np.concatenate(regressors), np.concatenate(instruments), np.concatenate(right)
    weight = np.ones(2 * count)
    for _ in range(ROUNDS):
        answer = np.linalg.solve((z * weight[:, None]).T @ a, (z * weight[:, None]).T @ b)
        weight = robust_weights(b - a @ answer)
    row, column = np.tile(_bands(place), (2, 1)).T
    variance = variance_by_bands(a, z * weight[:, None], b - a @ answer, row=row, column=column)
    return IndexEstimate(float(answer[0]), float(np.sqrt(variance)), count)


def _across(upright: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors at right angles to ``upright`` and to each other."""
    first = np.cross(upright, np.eye(3)[np.argmin(np.abs(upright))])
    first /= np.linalg.norm(first)
    return first, np.cross(upright, first)


def _smooth_basis(place: np.ndarray) -> np.ndarray:
    """Return all products of row and column up to the third order."""
    row, column = 2 * place.T - 1
    return np.column_stack([row**i * column**j for i in range(4) for j in range(4 - i)])


def _bands(place: np.ndarray) -> Int64[np.ndarray, "pixels 2"]:
    """Return the band of rows and the band of columns that each pixel lies in."""
    return np.minimum((place * BANDS_A_SIDE).astype(np.int64), BANDS_A_SIDE - 1)
