"""The samples about each pixel's peak, ready to be fitted."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

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

    @property
    def half_width(self) -> int:
        """Return how many samples lie on each side of the peak."""
        return self.height.shape[1] // 2

    def some(self, pixels: np.ndarray) -> "CurveSamples":
        """Return the samples of some of the pixels."""
        return CurveSamples(self.height[pixels], self.usable[pixels], self.peak[pixels], self.peak_px[pixels])


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

    def samples(self, pixels: Int64[np.ndarray, " pixels"]) -> CurveSamples:
        """Make the samples of these pixels ready to fit."""
        windows, pattern = self.windows, self.table.pattern
        counts = windows.samples[pixels]
        peak = windows.peak_index[pixels].astype(np.int64)
        number = peak[:, None] + np.arange(-windows.half_width, windows.half_width + 1)
        inside = (number >= 0) & (number < windows.photo_count)
        return CurveSamples(
            height=counts.astype(np.float32) - self.black[pixels].astype(np.float32)[:, None],
            usable=inside & (counts < self.clipped),
            peak=peak,
            peak_px=pattern.first_px + pattern.step_px * peak.astype(np.float64),
        )
