"""What a crossing of two light paths must pass to be a point."""

import numpy as np
from jaxtyping import Bool, UInt8

from recon.geometry.entry_point import EntryPoints
from recon.method import Limits, Method
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus


def crossing_tests(
    points: EntryPoints, manifest: Manifest, *, method: Method, limits: Limits
) -> UInt8[np.ndarray, " pixels"]:
    """Test each crossing; where several tests fail the one that explains most is named."""
    status = np.full(len(points.gap_mm), PixelStatus.OK, dtype=np.uint8)
    centres = [np.array(pose.centre_mm) for pose in manifest.display_poses]
    separation = float(np.linalg.norm(centres[1] - centres[0]))
    with np.errstate(divide="ignore", invalid="ignore"):
        if method == "paper":
            parallel = ~(points.angle_rad > limits.smallest_angle_rad)
            apart = ~(np.abs(points.gap_mm) < limits.largest_gap_share * separation)
        else:
            parallel = ~(points.angle_rad > limits.angle_sigma * points.angle_sd_rad)
            apart = ~(np.abs(points.gap_mm) < limits.gap_sigma * points.gap_sd_mm)
    status[outside_depth(points, manifest)] = PixelStatus.OUTSIDE_DEPTH
    status[apart] = PixelStatus.GAP_TOO_LARGE
    status[parallel] = PixelStatus.PARALLEL_PATHS
    return status


def outside_depth(points: EntryPoints, manifest: Manifest) -> Bool[np.ndarray, " pixels"]:
    """Return which points are not between the nearer display and the camera (or simply behind the display)."""
    outside = ~(points.distance_liquid_mm > 0) | ~(points.distance_air_mm > 0)
    if manifest.camera.pose is not None:
        centre = np.array(manifest.camera.pose.centre_mm)
        forward = manifest.camera.pose.world_from_screen()[:3, 2]
        outside |= ~((points.point_mm - centre) @ forward > 0)
    return outside
