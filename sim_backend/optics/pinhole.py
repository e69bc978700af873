"""A pinhole camera with lens distortion: from places in a photo to rays."""

import numpy as np
from jaxtyping import Float64

Places = Float64[np.ndarray, " rays"]
Vectors = Float64[np.ndarray, "rays 3"]

# Newton's method doubles the correct digits each time; from the undistorted start, eight reach rounding even for
# lenses with 20 % distortion.
NEWTON_STEPS = 8


def distort(x: Places, y: Places, coefficients: tuple[float, ...]) -> tuple[Places, Places]:
    """Apply OpenCV's lens model (k1, k2, p1, p2, k3) to coordinates in units of the focal length."""
    k1, k2, p1, p2, k3 = (*coefficients, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
        y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
    )


def undistort(x: Places, y: Places, coefficients: tuple[float, ...]) -> tuple[Places, Places]:
    """Invert :func:`distort` by Newton's method with a numeric derivative."""
    if not any(coefficients):
        return x, y
    straight_x, straight_y = x.copy(), y.copy()
    nudge = 1e-6
    for _ in range(NEWTON_STEPS):
        bent_x, bent_y = distort(straight_x, straight_y, coefficients)
        right_x, right_y = distort(straight_x + nudge, straight_y, coefficients)
        below_x, below_y = distort(straight_x, straight_y + nudge, coefficients)
        xx, yx = (right_x - bent_x) / nudge, (right_y - bent_y) / nudge
        xy, yy = (below_x - bent_x) / nudge, (below_y - bent_y) / nudge
        miss_x, miss_y = x - bent_x, y - bent_y
        area = xx * yy - xy * yx
        straight_x = straight_x + (yy * miss_x - xy * miss_y) / area
        straight_y = straight_y + (xx * miss_y - yx * miss_x) / area
    return straight_x, straight_y


def camera_directions(
    column: Places,
    row: Places,
    *,
    focal_px: tuple[float, float],
    centre_px: tuple[float, float],
    distortion: tuple[float, ...],
    world_from_camera: Float64[np.ndarray, "3 3"],
) -> Vectors:
    """Return the unit direction in which the camera looks through each place of the photo.

    (0, 0) is the centre of the top-left pixel; the columns of ``world_from_camera`` are the camera's x, y and
    forward axes in the world.
    """
    x, y = undistort((column - centre_px[0]) / focal_px[0], (row - centre_px[1]) / focal_px[1], distortion)
    directions = np.stack([x, y, np.ones_like(x)], axis=1) @ world_from_camera.T
    return directions / np.sqrt(np.einsum("ij,ij->i", directions, directions))[:, None]
