"""Visual rays of a calibrated camera, in the shape of measured light paths: what two sets without the object would show."""

import numpy as np
from jaxtyping import Float64

from recon.geometry.light_paths import LightPaths, ScreenNoise
from recon.sessions.manifest import Pose


def camera_rays(
    centre_mm: Float64[np.ndarray, " 3"], ray: Float64[np.ndarray, "pixels 3"], poses: tuple[Pose, Pose]
) -> LightPaths:
    """Return the straight lines from the display to the camera along unit ``ray``, which point away from the camera.

    They are cut by the planes of the two display positions, so that distances along them count from the nearer one, as on
    measured paths. They carry no uncertainty: that of a calibration is common to all pixels, and no scatter.
    """
    distance = []
    for pose in poses:
        world_from_screen = pose.world_from_screen()
        away, place = world_from_screen[:3, 2], world_from_screen[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance.append(((place - centre_mm) @ away) / (ray @ away))
    near, far = np.minimum(*distance), np.maximum(*distance)
    nothing = ScreenNoise(np.zeros((len(ray), 2)), np.eye(3)[:, :2])
    return LightPaths(
        near_mm=centre_mm + near[:, None] * ray,
        direction=-ray,
        baseline_mm=far - near,
        near_noise=nothing,
        far_noise=nothing,
    )
