"""Lines a period apart, and the Gray code that tells which period: what each photo of a ``gray_line`` sweep shows.

::

    line shift   ▁█▁▁▁▁▁▁▁█▁▁▁▁▁▁▁█▁▁▁▁▁▁   one photo a step of a period: where within the period
    Gray code    ▁▁▁▁████████▁▁▁▁▁▁▁▁████   two photos a bit, the second inverted: which half period

Half periods side by side differ in one bit, so a pixel that sees an edge reads one of the two; and as a number names half a
period, a number that is wrong by one still leaves no doubt about the period. The reading side is in
:mod:`recon.sweeps.gray_line`. Beyond the swept area every photo is dark.
"""

import numpy as np
from jaxtyping import Bool, Int32, UInt8

from recon.patterns.sweep_frames import device_brightness
from recon.sessions.pattern import GrayLinePattern

FULL_LEVEL = 255


def gray_line_levels(pattern: GrayLinePattern, index: int, *, device_px: int) -> UInt8[np.ndarray, " device_px"]:
    """Return the drive levels of photo ``index`` on a display with ``device_px`` pixels along the sweep."""
    if index < pattern.steps:
        return _line_levels(pattern, index, device_px=device_px)
    bit, inverted = divmod(index - pattern.steps, 2)
    return _bar_levels(pattern, bit, inverted=bool(inverted), device_px=device_px)


def bar_edges_px(pattern: GrayLinePattern) -> tuple[float, float]:
    """Return where bar 0 begins, and how wide a bar is: half a period."""
    return pattern.first_px - pattern.step_px / 2, pattern.period_px / 2


def gray_code(number: Int32[np.ndarray, "..."]) -> Int32[np.ndarray, "..."]:
    """Return the reflected binary code of these numbers."""
    return number ^ (number >> 1)


def _line_levels(pattern: GrayLinePattern, shift: int, *, device_px: int) -> np.ndarray:
    stripe = np.arange(shift, pattern.places, pattern.steps)
    place_px = pattern.first_px + pattern.step_px * stripe
    device = np.arange(device_px, dtype=np.float64)
    # Only the nearest line lights a pixel: lines are half as wide as they are apart at most.
    nearest = np.clip(np.rint((device - place_px[0]) / pattern.period_px), 0, len(stripe) - 1).astype(np.int64)
    brightness = device_brightness(device - place_px[nearest], pattern.as_sweep())
    return np.round(FULL_LEVEL * brightness).astype(np.uint8)


def _bar_levels(pattern: GrayLinePattern, bit: int, *, inverted: bool, device_px: int) -> np.ndarray:
    low_px, bar_px = bar_edges_px(pattern)
    device = np.arange(device_px, dtype=np.float64)
    bar = np.floor((device - low_px) / bar_px).astype(np.int32)
    lit = _bit(gray_code(np.clip(bar, 0, None)), bit) != inverted
    swept = (device >= low_px) & (device < low_px + pattern.places * pattern.step_px)
    return np.where(lit & swept, FULL_LEVEL, 0).astype(np.uint8)


def _bit(code: np.ndarray, bit: int) -> Bool[np.ndarray, "..."]:
    return ((code >> bit) & 1).astype(bool)
