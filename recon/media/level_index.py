"""The liquid's index from its own flat surface, where the camera sees the display past the object.

Each such pixel's two paths obey Snell's law at one plane: parallel to it, n_liquid U = n_air V. The plane's direction is one for
all pixels and is found with the index; it also takes up a tilt of all paths alike, such as a slipped display makes.
"""

import numpy as np
from jaxtyping import Float64, Int64

from recon.geometry.light_paths import LightPaths
from recon.media.index_estimate import (
    IndexEstimate,
    robust_weights,
    variance_by_bands,
    variance_by_leaving_out,
)

FEWEST_PIXELS = 300
ROUNDS = 8
BANDS_A_SIDE = 24
# Water's; it only weighs the two paths' errors and turns a tilt into what it does to both.
PROVISIONAL_N = 1.333
# No pixel counts without limit for being surer than the others.
LEAST_VARIANCE_SHARE = 1e-3
# (power of the row, power of the column) of what varies smoothly over the photo.
TERMS = tuple((i, j) for i in range(4) for j in range(4 - i))


def index_from_level(
    liquid: LightPaths,
    air: LightPaths,
    *,
    upright: Float64[np.ndarray, " 3"],
    place: Float64[np.ndarray, "pixels 2"],
    n_air: float,
) -> IndexEstimate | None:
    """Return the index that makes one plane refract every pixel's path in air into its path in liquid.

    Parameters
    ----------
    liquid, air : the two paths.
    upright : the surface's normal, roughly; it is refined.
    place : row and column of each pixel, from 0 to 1 over the photo.
    n_air : index of air.

    Notes
    -----
    With e at right angles to the upright m: n_liquid U·e − n_air V·e − κ m·(n_liquid U − n_air V) = 0, κ the tilt along e.
    Noise in U would pull the index towards 0 in least squares. So the equations are projected on V·e as a smooth function of the
    pixel's place, which has no noise (instrumental variables). Each counts by what its places' own sds make of it.
    """
    count = len(liquid.direction)
    if count < FEWEST_PIXELS:
        return None
    axes = _across(upright)
    smooth = _smooth_basis(place)
    along = (PROVISIONAL_N * liquid.direction - n_air * air.direction) @ upright
    zero = np.zeros(count)
    regressors, instruments, right, variances, rings = [], [], [], [], []
    for number, axis in enumerate(axes):
        tilts = [-along if other == number else zero for other in range(2)]
        sideways = n_air * (air.direction @ axis)
        coefficients = np.linalg.lstsq(smooth, sideways, rcond=None)[0]
        regressors.append(np.column_stack([liquid.direction @ axis, *tilts]))
        instruments.append(np.column_stack([smooth @ coefficients, *tilts]))
        right.append(sideways)
        variances.append(_variance(liquid, air, axis, n_air=n_air))
        rings.append(_rings(place, coefficients))
    a, z, b = np.concatenate(regressors), np.concatenate(instruments), np.concatenate(right)
    certainty = _certainty(np.concatenate(variances))
    weight = certainty
    for _ in range(ROUNDS):
        answer = np.linalg.solve((z * weight[:, None]).T @ a, (z * weight[:, None]).T @ b)
        weight = certainty * robust_weights((b - a @ answer) * np.sqrt(certainty))
    pull = z * weight[:, None]
    row, column = np.tile(_bands(place), (2, 1)).T
    variance = max(
        variance_by_bands(a, pull, b - a @ answer, row=row, column=column),
        variance_by_leaving_out(a, pull, b, np.concatenate(rings)),
    )
    return IndexEstimate(float(answer[0]), float(np.sqrt(variance)), count)


def _variance(
    liquid: LightPaths, air: LightPaths, axis: Float64[np.ndarray, " 3"], *, n_air: float
) -> Float64[np.ndarray, " pixels"]:
    """Return the variance of each pixel's equation along an axis, from what is known of its places."""
    along = np.broadcast_to(axis, liquid.direction.shape)
    return PROVISIONAL_N**2 * liquid.turn_variance_along(along) + n_air**2 * air.turn_variance_along(along)


def _certainty(variance: Float64[np.ndarray, " equations"]) -> Float64[np.ndarray, " equations"]:
    """Return one over the variances, and ones where nothing is known of them."""
    typical = float(np.median(variance))
    if typical == 0:
        return np.ones_like(variance)
    return 1 / np.maximum(variance, LEAST_VARIANCE_SHARE * typical)


def _rings(
    place: Float64[np.ndarray, "pixels 2"], coefficients: Float64[np.ndarray, " terms"]
) -> Int64[np.ndarray, " pixels"]:
    """Return how far each pixel is from the photo's middle, along the side of it on which the equation depends, in bands.

    Where camera and display stand mirror-symmetric to the pixel, errors on all four sides of a ring are alike.
    """
    by_row, by_column = (abs(coefficients[TERMS.index(power)]) for power in ((1, 0), (0, 1)))
    side = place[:, 0] if by_row > by_column else place[:, 1]
    count = BANDS_A_SIDE // 2
    return np.minimum((np.abs(2 * side - 1) * count).astype(np.int64), count - 1)


def _across(upright: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors at right angles to ``upright`` and to each other."""
    first = np.cross(upright, np.eye(3)[np.argmin(np.abs(upright))])
    first /= np.linalg.norm(first)
    return first, np.cross(upright, first)


def _smooth_basis(place: np.ndarray) -> np.ndarray:
    """Return all products of row and column up to the third order."""
    row, column = 2 * place.T - 1
    return np.column_stack([row**i * column**j for i, j in TERMS])


def _bands(place: np.ndarray) -> Int64[np.ndarray, "pixels 2"]:
    """Return the band of rows and the band of columns that each pixel lies in."""
    return np.minimum((place * BANDS_A_SIDE).astype(np.int64), BANDS_A_SIDE - 1)
