"""The camera's own rays, for what needs them: integration on the camera grid, and thin objects."""

import numpy as np
from jaxtyping import Float64

from recon.calibration.lens import lens_numbers, view_rays
from recon.sessions.manifest import CameraBody


def sight_rays(
    camera: CameraBody,
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, "rows cols 3"]] | None:
    """Return the camera's centre and each pixel's unit direction in the world; None where the manifest lacks either.

    Distortion is OpenCV's (k1, k2, p1, p2, k3), undone to rounding.
    """
    if camera.pose is None or camera.intrinsics is None:
        return None
    cols, rows = np.meshgrid(np.arange(camera.columns, dtype=np.float64), np.arange(camera.rows, dtype=np.float64))
    direction = view_rays(np.stack([cols.ravel(), rows.ravel()], axis=1), lens_numbers(camera.intrinsics))
    world_from_camera = camera.pose.world_from_screen()
    world = direction @ world_from_camera[:3, :3].T
    return world_from_camera[:3, 3], world.reshape(camera.rows, camera.columns, 3)
