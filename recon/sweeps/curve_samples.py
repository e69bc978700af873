"""The samples about each pixel's peak, ready to be fitted."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, Int64

from recon.compiled import compiled
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
        shape = (len(pixels), windows.samples.shape[1])
        height, usable = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=bool)
        peak = np.empty(len(pixels), dtype=np.int64)
        counts = (windows.samples, windows.peak_index, self.black)
        write_samples(pixels, *counts, self.clipped, windows.photo_count, height, usable, peak)
        return CurveSamples(
            height=height,
            usable=usable,
            peak=peak,
            peak_px=pattern.first_px + pattern.step_px * peak.astype(np.float64),
        )


@compiled
def write_weights(
    height: np.ndarray, usable: np.ndarray, read: float, gain: float, relative: float, weight: np.ndarray
) -> None:
    """Write one over the variance ``read + gain·h + (relative·h)²`` of samples [pixels, samples]; zero for those not usable."""
    # In the precision of the samples: all lanes of a core divide at once.
    constant, linear, square = np.float32(read), np.float32(gain), np.float32(relative * relative)
    for pixel in range(len(height)):
        for s in range(np.uintp(height.shape[1])):
            light = max(np.float32(height[pixel, s]), np.float32(0))
            variance = constant + light * (linear + light * square)
            weight[pixel, s] = (np.float32(1) if usable[pixel, s] else np.float32(0)) / variance


@compiled
def write_samples(
    pixels: np.ndarray,
    samples: np.ndarray,
    peak_index: np.ndarray,
    black: np.ndarray,
    clipped: int,
    photo_count: int,
    height: np.ndarray,
    usable: np.ndarray,
    peak: np.ndarray,
) -> None:
    """Write some pixels' heights above black, which of them may be used, and the numbers of the photos in the middle."""
    count = samples.shape[1]
    half = count // 2
    for number in range(len(pixels)):
        # Indices without a sign: those with one are searched for negative ones.
        pixel = np.uintp(pixels[number])
        middle, dark = np.int64(peak_index[pixel]), np.float32(black[pixel])
        peak[number] = middle
        for s in range(np.uintp(count)):
            sample, photo = samples[pixel, s], middle + np.int64(s) - half
            height[number, s] = np.float32(sample) - dark
            usable[number, s] = sample < clipped and 0 <= photo < photo_count
