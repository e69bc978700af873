"""What a calibration with wet poses leaves unknown of the slips: a covariance, before any gap is looked at."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from recon.calibration.calibration_file import Calibration
from recon.calibration.display_poses import AIR_PANELS
from recon.calibration.wet_pose import WET_PANELS
from recon.registration.gap_fit import MotionCovariance
from recon.sessions.manifest import Pose

# Of a pose's six numbers (turns about x, y, z, then shifts), those of the motion in the plane, as this room orders them.
IN_PLANE = (3, 4, 2)


def known_slips(calibration: Calibration) -> MotionCovariance | None:
    """Return the covariance of the slips in the planes; None where the calibration has no wet poses, or no covariance of them."""
    if not calibration.covariance:
        return None
    return slips_of_poses({str(name): pose for name, pose in calibration.poses.items()}, calibration.pose_covariance())


def slips_of_poses(
    poses: Mapping[str, Pose], covariance: Float64[np.ndarray, "numbers numbers"]
) -> MotionCovariance | None:
    """Return the covariance of the slips in the planes for poses by set with their joint covariance, six numbers each in order.

    Gaps tell where a wet display stands beside the dry one at the same position, so what counts is the error of that difference.
    None where a set's pose is missing.
    """
    names = list(poses)
    if not set(AIR_PANELS) | set(WET_PANELS) <= set(names):
        return None
    jacobian = np.zeros((6, 6 * len(names)))
    for position, (dry, wet) in enumerate(zip(AIR_PANELS, WET_PANELS, strict=True)):
        across = poses[dry].world_from_screen()[:3, :3].T
        turn_and_shift = np.kron(np.eye(2), across)[list(IN_PLANE)]
        rows = slice(3 * position, 3 * position + 3)
        for name, sign in ((dry, -1.0), (wet, 1.0)):
            start = 6 * names.index(name)
            jacobian[rows, start : start + 6] = sign * turn_and_shift
    return jacobian @ covariance @ jacobian.T
