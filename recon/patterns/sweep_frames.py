"""What a pattern looks like on the display: from a pattern to the drive levels of each frame.

The reading side, from intensity curve to stripe place, is in ``stripe_peak.py`` and ``stripe_fit.py``.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from recon.sessions.manifest import Axis, DisplayPanel, StripePattern


@dataclass(frozen=True, slots=True, eq=False)
class PatternFrame:
    """One frame of a sweep: ``levels`` is one uint8 drive level a device pixel along ``axis``, ``place_px`` the stripe's centre.

    A frame that shows more than one stripe has no place.
    """

    axis: Axis
    index: int
    place_px: float | None
    levels: UInt8[np.ndarray, " device_px"]


def stripe_profile(offset_px: Float64[np.ndarray, "..."], pattern: StripePattern) -> Float64[np.ndarray, "..."]:
    """Return the stripe's brightness, 0 to 1, at a distance from its centre in device pixels."""
    distance_px = np.abs(offset_px)
    inside = distance_px < pattern.width_px / 2
    if pattern.profile == "hard":
        return inside.astype(np.float64)
    return np.where(inside, 0.5 * (1 + np.cos(2 * np.pi * distance_px / pattern.width_px)), 0.0)


def places_px(pattern: StripePattern) -> Float64[np.ndarray, " places"]:
    """Return the centre of every stripe of the sweep, in device pixels."""
    return pattern.first_px + pattern.step_px * np.arange(pattern.count, dtype=np.float64)


def stripe_frame(pattern: StripePattern, axis: Axis, index: int, *, device_px: int) -> PatternFrame:
    """Return frame ``index`` of a sweep on a display with ``device_px`` pixels along ``axis``.

    A hard stripe whose edge falls inside a device pixel lights that pixel in proportion, so that its centre of mass
    stays where the plan says.
    """
    place_px = float(pattern.first_px + pattern.step_px * index)
    brightness = device_brightness(np.arange(device_px, dtype=np.float64) - place_px, pattern)
    return PatternFrame(axis, index, place_px, np.round(255 * brightness).astype(np.uint8))


def device_brightness(offset_px: Float64[np.ndarray, "..."], pattern: StripePattern) -> Float64[np.ndarray, "..."]:
    """Return the brightness, 0 to 1, of a device pixel whose centre is ``offset_px`` from the stripe's centre."""
    if pattern.profile == "hard":
        half = pattern.width_px / 2
        return np.clip(offset_px + 0.5, -half, half) - np.clip(offset_px - 0.5, -half, half)
    return stripe_profile(offset_px, pattern)


def screen_mm(
    place_px: Float64[np.ndarray, " samples"], axis: Axis, display: DisplayPanel
) -> Float64[np.ndarray, " samples"]:
    """Turn device pixels into screen millimetres: origin at the panel's centre, x right, y down."""
    count = display.columns if axis == "x" else display.rows
    return (place_px + 0.5 - count / 2) * display.pitch_mm
