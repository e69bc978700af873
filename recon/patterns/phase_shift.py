"""Cosine fringes of several periods, shifted in equal steps: what each photo of a ``phase_shift`` sweep shows.

The reading side is in :mod:`recon.sweeps.phase_shift`. Beyond the area of the pattern every photo is dark.
"""

import numpy as np
from jaxtyping import Float64, UInt8

from recon.sessions.pattern import PhaseShiftPattern

FULL_LEVEL = 255


def phase_shift_levels(pattern: PhaseShiftPattern, index: int, *, device_px: int) -> UInt8[np.ndarray, " device_px"]:
    """Return the drive levels of photo ``index`` on a display with ``device_px`` pixels along the sweep."""
    device = np.arange(device_px, dtype=np.float64)
    shown = (device >= pattern.first_px) & (device <= pattern.last_px)
    return np.where(shown, np.round(FULL_LEVEL * fringe(pattern, index, device)), 0).astype(np.uint8)


def fringe(
    pattern: PhaseShiftPattern, index: int, place_px: Float64[np.ndarray, " places"]
) -> Float64[np.ndarray, " places"]:
    """Return the share of full drive, 0 to 1, that photo ``index`` shows at these places."""
    period, shift = divmod(index, pattern.steps)
    turns = (place_px - pattern.first_px) / pattern.periods_px[period] - shift / pattern.steps
    return 0.5 * (1 + np.cos(2 * np.pi * turns))


def periods_for(area_px: float, *, finest_px: float, frequencies: int) -> tuple[float, ...]:
    """Return periods, coarsest first, in equal ratios from a tenth more than the area down to ``finest_px``.

    Equal ratios make every step of the unwrapping as safe as the others; the tenth keeps noise at one end of the display from
    being read as the other end.
    """
    if frequencies == 1 or finest_px >= 1.1 * area_px:
        return (max(1.1 * area_px, finest_px),)
    return tuple(float(period) for period in np.geomspace(1.1 * area_px, finest_px, frequencies))
