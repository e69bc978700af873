"""What a shift between sets costs: the error of a first entry point (FEP) that follows from its geometry.

One set's display points are off by s, along the display and in the plane of a pixel's two paths. If a is where the FEP lies
along that path, in units of its baseline (0 at position 0, 1 at position 1; an object before position 0 has a < 0), the path
is off by (1 − a)·s there when position 0 slipped and by a·s when position 1 did. It crosses the other path, at the angle Δθ, the
farther off the flatter they cross:

    error = lever · s / sin Δθ,   lever = max(|1 − a|, |a|) for a display, 1 for an object that moved as a whole.

This is the error along the other path, for the worse of the two positions and the worst direction of s; a fitted surface hides a
part of it. It is the systematic counterpart of the FEP's covariance (:mod:`recon.geometry.entry_point`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.sessions.manifest import CameraBody, Pose

# Where nothing is known of the object: half a baseline before position 0, met at this angle to its normal.
TYPICAL_PLACE = -0.5
TYPICAL_INCIDENCE_RAD = np.radians(30.0)


def fep_error_mm(shift_mm: float, *, lever: float, angle_rad: float) -> float:
    """Return the error of an FEP for a shift of ``shift_mm`` on the display, where the paths cross at ``angle_rad``."""
    return lever * shift_mm / float(np.sin(angle_rad))


def display_lever(place: Float64[np.ndarray, " points"]) -> Float64[np.ndarray, " points"]:
    """Return the lever of a display's slip at FEPs that lie at ``place`` along their paths, in baselines."""
    return np.maximum(np.abs(1 - place), np.abs(place))


def places_along_paths(
    point_mm: Float64[np.ndarray, "points 3"], poses: tuple[Pose, Pose]
) -> Float64[np.ndarray, " points"]:
    """Return where FEPs lie along their paths, in baselines, by their distances from the planes of the two positions."""
    distances = []
    for pose in poses:
        normal = np.cross(pose.x_axis, pose.y_axis)
        distances.append((point_mm - np.array(pose.centre_mm)) @ normal)
    return distances[0] / (distances[0] - distances[1])


def typical_angle_rad(*, n_liquid: float, n_air: float) -> float:
    """Return the angle between the paths in liquid and in air of a pixel whose path in the liquid meets the object at 30°.

    Snell's law on both sides of the same facet: n_liquid sin θ_liquid = n_air sin θ_air; total reflection counts as 90°.
    """
    sine = n_liquid / n_air * np.sin(TYPICAL_INCIDENCE_RAD)
    return float(abs(np.arcsin(min(sine, 1.0)) - TYPICAL_INCIDENCE_RAD))


def photo_scale_mm(camera: CameraBody, display: Pose) -> float | None:
    """Return how many mm on the display one photo pixel sees at its centre, None for a camera that was not calibrated."""
    if camera.pose is None or camera.intrinsics is None:
        return None
    forward = np.cross(camera.pose.x_axis, camera.pose.y_axis)
    depth_mm = float((np.array(display.centre_mm) - np.array(camera.pose.centre_mm)) @ forward)
    return depth_mm / float(np.sqrt(camera.intrinsics.focal_x_px * camera.intrinsics.focal_y_px))


@dataclass(frozen=True, slots=True)
class ErrorScale:
    """From photo px to the error of an FEP: px to mm, and what a display's slip and a motion as a whole are multiplied by."""

    mm_per_px: float
    display: float
    whole: float

    def error_mm(self, shift_px: float, *, of_display: bool) -> float:
        """Return the error for a shift that was seen in the photo."""
        return shift_px * self.mm_per_px * (self.display if of_display else self.whole)


def typical_scale(camera: CameraBody, poses: tuple[Pose, Pose], *, n_liquid: float, n_air: float) -> ErrorScale | None:
    """Return the scale before anything is known of the object; None for a camera that was not calibrated."""
    mm_per_px = photo_scale_mm(camera, poses[0])
    if mm_per_px is None:
        return None
    angle_rad = typical_angle_rad(n_liquid=n_liquid, n_air=n_air)
    lever = float(display_lever(np.array([TYPICAL_PLACE]))[0])
    return ErrorScale(
        mm_per_px,
        display=fep_error_mm(1.0, lever=lever, angle_rad=angle_rad),
        whole=fep_error_mm(1.0, lever=1.0, angle_rad=angle_rad),
    )


def measured_scale(
    camera: CameraBody,
    poses: tuple[Pose, Pose],
    *,
    point_mm: Float64[np.ndarray, "points 3"],
    angle_rad: Float64[np.ndarray, " points"],
) -> ErrorScale | None:
    """Return the scale of a reconstructed object: the medians over its FEPs; None without any, or without a calibrated camera."""
    mm_per_px = photo_scale_mm(camera, poses[0])
    sound = np.isfinite(point_mm).all(axis=1) & (angle_rad > 0)
    if mm_per_px is None or not sound.any():
        return None
    sine = np.sin(angle_rad[sound])
    lever = display_lever(places_along_paths(point_mm[sound], poses))
    return ErrorScale(mm_per_px, display=float(np.median(lever / sine)), whole=float(np.median(1 / sine)))
