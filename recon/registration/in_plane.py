"""Small motions of a display in its own plane: a shift along its x and y axes and a turn about its normal, at its centre."""

import numpy as np
from jaxtyping import Float64

from recon.sessions.manifest import Pose

# Three numbers a display: shift along its x and its y axis in mm, turn about x × y in rad.
Motion = Float64[np.ndarray, " 3"]


def moved_in_plane(pose: Pose, motion: Motion) -> Pose:
    """Return where the display stands after a motion in its plane."""
    frame = pose.world_from_screen()
    x, y = frame[:3, 0], frame[:3, 1]
    cosine, sine = np.cos(motion[2]), np.sin(motion[2])
    centre = frame[:3, 3] + motion[0] * x + motion[1] * y
    return Pose(centre_mm=_vector(centre), x_axis=_vector(cosine * x + sine * y), y_axis=_vector(cosine * y - sine * x))


def shifts_by_motion(point_mm: Float64[np.ndarray, "points 3"], pose: Pose) -> Float64[np.ndarray, "points 3 3"]:
    """Return by how much each point of a display moves for each of the motion's numbers: [point, axis, number]."""
    frame = pose.world_from_screen()
    turn = np.cross(frame[:3, 2], point_mm - frame[:3, 3])
    shape = point_mm.shape
    return np.stack([np.broadcast_to(frame[:3, 0], shape), np.broadcast_to(frame[:3, 1], shape), turn], axis=2)


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
