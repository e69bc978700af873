"""What is known of a rig before a session's own photos of the board are read: lens, the stage's way, the liquid's level.

A calibration says it with its covariance. A manifest states no uncertainty; then that of an ordinary calibration is assumed,
and said in the report.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.calibration.calibration_file import Calibration
from recon.calibration.display_poses import AIR_PANELS, Travel
from recon.calibration.lens import Lens, lens_numbers
from recon.calibration.sight_line import LiquidPlane
from recon.sessions.manifest import Manifest

# What fifteen views of a board leave, as shares of the photo's longer side (focal lengths, centre), and of k1, k2, p1, p2, k3.
ASSUMED_LENS_SHARE = 2.5e-4
ASSUMED_DISTORTION_SD = (1e-3, 7e-3, 6e-5, 7e-5, 2e-2)
# A stage that was homed comes back to its places to within this.
ASSUMED_TRAVEL_SD_MM = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class RigKnowledge:
    """Lens with its covariance, the way between the display's positions, the level if it was measured; ``source`` in words."""

    lens: Lens
    lens_covariance: Float64[np.ndarray, "9 9"]
    travel: Travel
    level: LiquidPlane | None
    source: str


def rig_knowledge(manifest: Manifest, calibration: Calibration | None) -> RigKnowledge | None:
    """Return what is known of the rig; None where nothing is known of the lens.

    ``manifest`` is the one with the calibration taken over, if there is one.
    """
    intrinsics = manifest.camera.intrinsics
    if intrinsics is None:
        return None
    first, second = (np.array(pose.centre_mm) for pose in manifest.display_poses)
    travel_mm = float(np.linalg.norm(second - first))
    lens = lens_numbers(intrinsics)
    if calibration is not None and np.all(np.diag(np.array(calibration.camera.covariance)) > 0):
        level = calibration.level
        return RigKnowledge(
            lens,
            np.array(calibration.camera.covariance, dtype=np.float64),
            Travel(travel_mm, _travel_sd_mm(calibration)),
            LiquidPlane(np.array(level.down), level.distance_mm) if level else None,
            f"lens and travel as the calibration of {calibration.created[:10]} says",
        )
    focal_sd_px = ASSUMED_LENS_SHARE * max(manifest.camera.columns, manifest.camera.rows)
    sd = np.array([focal_sd_px] * 4 + list(ASSUMED_DISTORTION_SD))
    return RigKnowledge(
        lens,
        np.diag(sd**2),
        Travel(travel_mm, ASSUMED_TRAVEL_SD_MM),
        None,
        f"lens of the manifest, taken as known to {focal_sd_px:.2g} px (focal lengths and centre), and its travel, to "
        f"{ASSUMED_TRAVEL_SD_MM:g} mm; a calibration.json would say it",
    )


def _travel_sd_mm(calibration: Calibration) -> float:
    """Return how well the calibration knows the distance between the two dry positions, the stage's own repeatability added."""
    names = [str(name) for name in calibration.poses]
    first, second = (
        np.array(calibration.poses["pos0_air"].centre_mm),
        np.array(calibration.poses["pos1_air"].centre_mm),
    )
    way = (second - first) / np.linalg.norm(second - first)
    by_way = np.zeros(6 * len(names))
    for sign, name in zip((-1, 1), AIR_PANELS, strict=True):
        start = 6 * names.index(name) + 3
        by_way[start : start + 3] = sign * way
    variance = float(by_way @ calibration.pose_covariance() @ by_way)
    return float(np.sqrt(variance + ASSUMED_TRAVEL_SD_MM**2))
