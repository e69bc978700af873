"""The camera's lens: a pinhole with OpenCV's distortion, as nine numbers.

The numbers are focal_x_px, focal_y_px, centre_x_px, centre_y_px, k1, k2, p1, p2, k3, in that order everywhere.
"""

import numpy as np
from jaxtyping import Float64

from recon.sessions.manifest import Intrinsics

Lens = Float64[np.ndarray, " 9"]
LENS_NAMES = ("focal_x_px", "focal_y_px", "centre_x_px", "centre_y_px", "k1", "k2", "p1", "p2", "k3")

NEWTON_STEPS = 10
ROUNDING = 1e-14  # of coordinates in units of the focal length


def solve_2_by_2(
    matrix: Float64[np.ndarray, "places 2 2"], right: Float64[np.ndarray, "places 2"]
) -> Float64[np.ndarray, "places 2"]:
    """Return the solutions of many systems of two equations, by Cramer's rule."""
    (a, b), (c, d) = matrix.transpose(1, 2, 0)
    first, second = right.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.column_stack([d * first - b * second, a * second - c * first]) / (a * d - b * c)[:, None]


def lens_numbers(intrinsics: Intrinsics) -> Lens:
    """Return the nine numbers of a manifest's intrinsics."""
    distortion = (*intrinsics.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    focal = (intrinsics.focal_x_px, intrinsics.focal_y_px)
    return np.array([*focal, intrinsics.centre_x_px, intrinsics.centre_y_px, *distortion], dtype=np.float64)


def intrinsics_of(lens: Lens) -> Intrinsics:
    """Return the intrinsics for a manifest."""
    focal_x, focal_y, centre_x, centre_y, *distortion = (float(number) for number in lens)
    return Intrinsics(
        focal_x_px=focal_x,
        focal_y_px=focal_y,
        centre_x_px=centre_x,
        centre_y_px=centre_y,
        distortion=tuple(distortion),
    )


def camera_matrix(lens: Lens) -> Float64[np.ndarray, "3 3"]:
    """Return OpenCV's camera matrix."""
    return np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]], dtype=np.float64)


def view_rays(place_px: Float64[np.ndarray, "places 2"], lens: Lens) -> Float64[np.ndarray, "places 3"]:
    """Return the unit directions, in the camera's frame, in which the camera looks through places of its photo."""
    bent = (place_px - lens[2:4]) / lens[0:2]
    straight = bent.copy()
    if np.any(lens[4:]):
        for _ in range(NEWTON_STEPS):
            value, jacobian = _distorted(straight, lens[4:])
            step = solve_2_by_2(jacobian, value - bent)
            straight = straight - step
            if np.abs(step).max(initial=0.0) < ROUNDING:
                break
    rays = np.column_stack([straight, np.ones(len(straight))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _distorted(
    place: Float64[np.ndarray, "places 2"], distortion: Float64[np.ndarray, " 5"]
) -> tuple[Float64[np.ndarray, "places 2"], Float64[np.ndarray, "places 2 2"]]:
    """Return distorted coordinates in units of the focal length, and their derivative."""
    k1, k2, p1, p2, k3 = distortion
    x, y = place.T
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))  # d radial / dx = slope · x
    value = np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ]
    )
    across = slope * x * y + 2 * p1 * x + 2 * p2 * y
    jacobian = np.empty((len(x), 2, 2))
    jacobian[:, 0, 0] = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = across
    jacobian[:, 1, 1] = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return value, jacobian
