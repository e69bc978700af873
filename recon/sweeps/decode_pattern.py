"""Reads a sweep, whatever its pattern: the counterpart of :mod:`recon.patterns.pattern_frames`."""

from collections.abc import Callable

from recon.method import Method
from recon.sessions.manifest import Axis, CaptureSet
from recon.sessions.pattern import GrayLinePattern, StripePattern
from recon.sessions.session import Session
from recon.sweeps.correspondence import SweepResult, decode_sweep
from recon.sweeps.gray_line import decode_gray_line
from recon.sweeps.phase_shift import decode_phase_shift


def decode_pattern(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    *,
    method: Method,
    on_photo: Callable[[], None] = lambda: None,
) -> SweepResult:
    """Stream the photos of one sweep and return every pixel's place on the display.

    Fringes are read in one way, whatever the method.
    """
    pattern = capture_set.sweep(axis).pattern
    if isinstance(pattern, StripePattern):
        return decode_sweep(session, capture_set, axis, method=method, on_photo=on_photo)
    if isinstance(pattern, GrayLinePattern):
        return decode_gray_line(session, capture_set, axis, method=method, on_photo=on_photo)
    return decode_phase_shift(session, capture_set, axis, on_photo=on_photo)
