"""The camera's own rays, for what needs them: integration on the camera grid, and thin objects."""

import cv2
import numpy as np
from jaxtyping import Float64

from recon.sessions.manifest import CameraBody


def sight_rays(
    camera: CameraBody,
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, "rows cols 3"]] | None:
    """Return the camera's centre and each pixel's unit direction in the world; None where the manifest lacks either.

    Distortion is OpenCV's (k1, k2, p1, p2, k3), undone by its own iteration.
    """
    if camera.pose is None or camera.intrinsics is None:
        return None
    lens = camera.intrinsics
    matrix = np.array([[lens.focal_x_px, 0, lens.centre_x_px], [0, lens.focal_y_px, lens.centre_y_px], [0, 0, 1.0]])
    cols, rows = np.meshgrid(np.arange(camera.columns, dtype=np.float64), np.arange(camera.rows, dtype=np.float64))
    pixels = np.stack([cols.ravel(), rows.ravel()], axis=1)[:, None, :]
    flat = cv2.undistortPoints(pixels, matrix, np.array(lens.distortion or (0.0,) * 5)).reshape(-1, 2)
    direction = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    world_from_camera = camera.pose.world_from_screen()
    world = direction @ world_from_camera[:3, :3].T
    return world_from_camera[:3, 3], world.reshape(camera.rows, camera.columns, 3)
