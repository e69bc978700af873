"""A coarse scan of the display: a few photos that tell which part of a sweep is seen at all.

The swept area is divided into bars, and each bar shows its number in reflected binary (Gray) code, one bit a photo: bars
side by side differ in one bit, so a pixel that sees the edge between two of them reads one or the other. Number 0 stays dark
and stands for the display beyond the swept area. With the white and the black photo of the set, each pixel's bits are
read against its own middle. Encoding and reading stand side by side here, so that they cannot part.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int32, UInt8

from recon.patterns.swept_range import FEWEST_STRIPES
from recon.sessions.manifest import Axis, CaptureSet, StripePattern
from recon.sessions.photos import Counts
from recon.sessions.session import Session

# More bits would save less than they cost: with six the bars are 1/63 of the swept area.
MOST_BITS = 6
# Bars as narrow as the stripe are what the set-up is made to resolve.
BAR_WIDTHS_OF_STRIPE = 1.0
# White must rise above black by more than noise explains, and by this share of the range of counts: five of 255.
LEAST_CONTRAST_SIGMA = 6.0
LEAST_CONTRAST = 0.02
# A pixel counts if so many of its eight neighbours see its bar or one beside it; noise does not agree with its neighbours,
# and where the map from camera to display is steepest (the rim of a ball) those along the rim still do.
FEWEST_AGREEING = 2

Region = tuple[int, int, int, int]  # first column, first row, last column, last row of a photo


@dataclass(frozen=True, slots=True)
class FoundRange:
    """First and last stripe that must be shown, margin included, and how many pixels this rests on."""

    first_index: int
    last_index: int
    pixels: int


def scan_name(axis: Axis) -> str:
    """Return how the journal calls the photos of the scan along ``axis``; their index is the bit."""
    return f"scan_{axis}"


def scan_bits(pattern: StripePattern) -> int:
    """Return how many photos the scan of a sweep takes; 0 where the sweep is too short to gain by one."""
    bars = int(_swept_px(pattern) / max(BAR_WIDTHS_OF_STRIPE * pattern.width_px, pattern.step_px))
    bits = min((bars + 1).bit_length() - 1, MOST_BITS)
    return bits if bits >= 2 and bits < pattern.count // 2 else 0


def scan_levels(pattern: StripePattern, bit: int, *, device_px: int) -> UInt8[np.ndarray, " device_px"]:
    """Return the drive levels of one photo of the scan on a display with ``device_px`` pixels along the sweep."""
    low_px = pattern.first_px - pattern.step_px / 2
    bar = np.floor((np.arange(device_px) - low_px) / _bar_px(pattern)).astype(np.int64)
    inside = (bar >= 0) & (bar < _bars(pattern))
    number = np.where(inside, bar + 1, 0)
    gray = number ^ (number >> 1)
    return (255 * ((gray >> bit) & 1)).astype(np.uint8)


def seen_bars(
    bits: Sequence[Counts], *, white: Counts, black: Counts, region: Region | None = None
) -> Int32[np.ndarray, "rows cols"]:
    """Return the bar that each pixel sees, 0 for the first; -1 where it sees none, or outside ``region``."""
    middle = (white.astype(np.float32) + black.astype(np.float32)) / 2
    number = np.zeros(white.shape, dtype=np.int32)
    above = np.zeros(white.shape, dtype=bool)
    # From Gray code to number: each bit is the parity of those from the highest down to it.
    for counts in reversed(bits):
        above ^= counts > middle
        number = 2 * number + above
    least = max(LEAST_CONTRAST * np.iinfo(white.dtype).max, LEAST_CONTRAST_SIGMA * np.sqrt(2) * _dark_sd(black))
    lit = white.astype(np.float32) - black > least
    seen = lit & _in_region(white.shape, region)
    bar = np.where(seen, number - 1, -1).astype(np.int32)
    return np.where(_agrees(bar), bar, -1).astype(np.int32)


def range_of_bars(
    bar: Int32[np.ndarray, "rows cols"], pattern: StripePattern, *, half_window: int
) -> FoundRange | None:
    """Return the stripes that the pixels need, or None where none sees the swept area.

    Beyond the outermost bars stands a margin of one bar, for faint pixels that the scan did not count, and of the
    ``half_window`` photos on either side that a pixel's place is made from: a pixel in the outermost bar is decoded from the
    same samples as in a full sweep.
    """
    found = bar[bar >= 0]
    if len(found) == 0:
        return None
    steps_a_bar = _bar_px(pattern) / pattern.step_px
    margin = steps_a_bar + half_window
    first = int(np.floor(found.min() * steps_a_bar - 0.5 - margin))
    last = int(np.ceil((found.max() + 1) * steps_a_bar - 0.5 + margin))
    first, last = max(first, 0), min(last, pattern.count - 1)
    first = min(first, pattern.count - FEWEST_STRIPES)
    return FoundRange(first, max(last, first + FEWEST_STRIPES - 1), len(found))


def read_scan(
    session: Session, capture_set: CaptureSet, axis: Axis, *, pattern: StripePattern, region: Region | None
) -> FoundRange | None:
    """Read the scan of one sweep from a session's photos; ``pattern`` is the whole sweep, before any narrowing."""

    # Loads SciPy, which would slow every command that only shows the scan.
    from recon.sweeps.correspondence import window_half_width
    from recon.sweeps.photo_stream import read_session_photo

    def photo(sweep: str, index: int = 0) -> Counts:
        return read_session_photo(session, capture_set.name, sweep, index)

    bits = [photo(scan_name(axis), bit) for bit in range(scan_bits(pattern))]
    bar = seen_bars(bits, white=photo("white"), black=photo("black"), region=region)
    return range_of_bars(bar, pattern, half_window=window_half_width(pattern, "full"))


def _dark_sd(black: Counts) -> float:
    """Return the noise of the black photo, from the differences of pixels side by side."""
    difference = np.diff(black.astype(np.float32), axis=1)
    return 1.4826 * float(np.median(np.abs(difference))) / np.sqrt(2)


def _swept_px(pattern: StripePattern) -> float:
    return pattern.step_px * pattern.count


def _bars(pattern: StripePattern) -> int:
    return 2 ** scan_bits(pattern) - 1


def _bar_px(pattern: StripePattern) -> float:
    return _swept_px(pattern) / _bars(pattern)


def _in_region(shape: tuple[int, ...], region: Region | None) -> Bool[np.ndarray, "rows cols"]:
    inside = np.zeros(shape, dtype=bool)
    left, top, right, bottom = region or (0, 0, shape[1] - 1, shape[0] - 1)
    inside[top : bottom + 1, left : right + 1] = True
    return inside


def _agrees(bar: Int32[np.ndarray, "rows cols"]) -> Bool[np.ndarray, "rows cols"]:
    """Return which pixels see a bar that enough of their neighbours see too, or its neighbour."""
    padded = np.pad(bar, 1, constant_values=-1)
    rows, cols = bar.shape
    agreeing = np.zeros(bar.shape, dtype=np.uint8)
    for down in range(3):
        for right in range(3):
            if (down, right) != (1, 1):
                other = padded[down : down + rows, right : right + cols]
                agreeing += (other >= 0) & (np.abs(other - bar) <= 1)
    return (bar >= 0) & (agreeing >= FEWEST_AGREEING)
