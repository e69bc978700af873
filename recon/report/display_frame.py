"""The frame in which the report shows things: that of the display at position 0, turned so that up is up.

x points right and y up as the viewer of the display sees them, z from the display towards the viewer, in mm from the
display's centre. z is therefore the distance in front of the display, and is what the page calls depth.
"""

import numpy as np
from jaxtyping import Float64

from recon.sessions.manifest import Manifest, Pose


def frame_from_world(manifest: Manifest) -> Float64[np.ndarray, "4 4"]:
    """Return the matrix that takes world points to the frame of the report."""
    # The screen's y points down and its z away from the viewer: half a turn about x makes up and towards positive.
    half_turn = np.diag([1.0, -1.0, -1.0, 1.0])
    return half_turn @ np.linalg.inv(manifest.display_poses[0].world_from_screen())


def transform_points(
    matrix: Float64[np.ndarray, "4 4"], point_mm: Float64[np.ndarray, "*grid 3"]
) -> Float64[np.ndarray, "*grid 3"]:
    """Return the points in another frame."""
    return point_mm @ matrix[:3, :3].T + matrix[:3, 3]


def depths(
    matrix: Float64[np.ndarray, "4 4"], point_mm: Float64[np.ndarray, "*grid 3"]
) -> Float64[np.ndarray, "*grid"]:
    """Return only the third coordinate of the points in another frame."""
    return point_mm @ matrix[2, :3] + matrix[2, 3]


def rotate(
    matrix: Float64[np.ndarray, "4 4"], normal: Float64[np.ndarray, "*grid 3"]
) -> Float64[np.ndarray, "*grid 3"]:
    """Return the directions in another frame."""
    return normal @ matrix[:3, :3].T


def screen_corners(
    frame: Float64[np.ndarray, "4 4"], pose: Pose, *, width_mm: float, height_mm: float
) -> Float64[np.ndarray, "4 3"]:
    """Return the corners of a screen in the frame of the report, in order round its edge."""
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    local = np.column_stack([signs * [width_mm / 2, height_mm / 2], np.zeros(4)])
    return transform_points(frame @ pose.world_from_screen(), local)
