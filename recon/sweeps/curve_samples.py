"""The samples about each pixel's peak, ready to be fitted."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, Int64

from recon.sweeps.curve_table import CurveTable
from recon.sweeps.stripe_peak import PeakWindows


@dataclass(frozen=True, slots=True, eq=False)
class CurveSamples:
    """Samples about the peak of each pixel.

    ``height`` is counts above black, ``usable`` tells which samples may be used (inside the sweep, not clipped), ``peak``
    is the number of the stripe in the middle of the window and ``peak_px`` its place in device pixels.
    """

    height: Float32[np.ndarray, "pixels samples"]
    usable: Bool[np.ndarray, "pixels samples"]
    peak: Int64[np.ndarray, " pixels"]
    peak_px: Float64[np.ndarray, " pixels"]


@dataclass(frozen=True, slots=True, eq=False)
class SweepCurves:
    """What the curves of one sweep are made from and compared with.

    ``windows`` hold the samples, ``black`` [pixels] the counts without the stripe, ``clipped`` is the first clipped count,
    and ``table`` holds the curves that the pattern can give.
    """

    windows: PeakWindows
    table: CurveTable
    black: np.ndarray
    clipped: int

    def samples(self, pixels: Int[np.ndarray, " pixels"]) -> CurveSamples:
        """Make the samples of these pixels ready to fit."""
        windows, pattern = self.windows, self.table.pattern
        counts = windows.samples[pixels]
        peak = windows.peak_index[pixels].astype(np.int64)
        usable = counts < self.clipped
        at_end = np.flatnonzero((peak < windows.half_width) | (peak >= windows.photo_count - windows.half_width))
        stripe = peak[at_end, None] + np.arange(-windows.half_width, windows.half_width + 1)
        usable[at_end] &= (stripe >= 0) & (stripe < windows.photo_count)
        return CurveSamples(
            height=np.subtract(counts, self.black[pixels, None], dtype=np.float32),
            usable=usable,
            peak=peak,
            peak_px=pattern.first_px + pattern.step_px * peak.astype(np.float64),
        )
