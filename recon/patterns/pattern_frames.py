"""The frames of a sweep, whatever its pattern."""

from recon.patterns.gray_line import gray_line_levels
from recon.patterns.phase_shift import phase_shift_levels
from recon.patterns.sweep_frames import PatternFrame, stripe_frame
from recon.sessions.manifest import Axis
from recon.sessions.pattern import GrayLinePattern, Pattern, StripePattern


def pattern_frame(pattern: Pattern, axis: Axis, index: int, *, device_px: int) -> PatternFrame:
    """Return frame ``index`` of a sweep on a display with ``device_px`` pixels along ``axis``."""
    if isinstance(pattern, StripePattern):
        return stripe_frame(pattern, axis, index, device_px=device_px)
    if isinstance(pattern, GrayLinePattern):
        levels = gray_line_levels(pattern, index, device_px=device_px)
    else:
        levels = phase_shift_levels(pattern, index, device_px=device_px)
    return PatternFrame(axis, index, place_of_photo(pattern, index), levels)


def place_of_photo(pattern: Pattern, index: int) -> float | None:
    """Return the centre of the one stripe that a photo shows, in device pixels; None where it shows more than one thing."""
    if isinstance(pattern, StripePattern):
        return float(pattern.first_px + pattern.step_px * index)
    return None
