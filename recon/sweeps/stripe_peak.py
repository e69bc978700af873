"""The samples about each pixel's brightest one (``peak_tracker.py`` finds them), and the paper's parabola through three of them.

The maximum-likelihood fit is in ``stripe_fit.py``, that of two peaks in ``two_paths.py``.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int, Int32

NO_PEAK = -1


@dataclass(frozen=True, slots=True, eq=False)
class PeakWindows:
    """The samples about each pixel's brightest one.

    ``peak_index`` [pixels] is the stripe number of the brightest sample, ``NO_PEAK`` where no sample rose above the
    floor; ``samples`` [pixels, 2 * half_width + 1] are the counts about it, zero beyond the sweep's ends. ``second`` holds the
    brightest maxima outside those windows, where a sweep was searched for them.
    """

    peak_index: Int32[np.ndarray, " pixels"]
    samples: np.ndarray
    half_width: int
    photo_count: int
    second: "SecondPeaks | None" = None

    def inside(self) -> np.ndarray:
        """Return which samples [pixels, window] exist, rather than lying beyond the sweep's ends."""
        place = self.peak_index[:, None] + np.arange(-self.half_width, self.half_width + 1)
        return (place >= 0) & (place < self.photo_count) & (self.peak_index[:, None] != NO_PEAK)


@dataclass(frozen=True, slots=True, eq=False)
class SecondPeaks:
    """The windows about a second maximum, of those pixels, in ascending order, that have one."""

    pixels: Int32[np.ndarray, " two"]
    windows: PeakWindows

    def rows_of(self, pixels: Int[np.ndarray, " pixels"]) -> Int[np.ndarray, " pixels"]:
        """Return in which rows of the windows these pixels are, ``NO_PEAK`` for most."""
        if not len(self.pixels):
            return np.full(len(pixels), NO_PEAK)
        row = np.minimum(np.searchsorted(self.pixels, pixels), len(self.pixels) - 1)
        return np.where(self.pixels[row] == pixels, row, NO_PEAK)


def parabola_offset(
    before: Float64[np.ndarray, " pixels"],
    centre: Float64[np.ndarray, " pixels"],
    after: Float64[np.ndarray, " pixels"],
) -> Float64[np.ndarray, " pixels"]:
    """Return the vertex of the parabola through three samples one step apart, in steps from the middle one.

    The paper's sub-stripe refinement (its section on correspondence). Zero where the three samples are equal.
    """
    curvature = before - 2 * centre + after
    safe = np.where(curvature < 0, curvature, -1.0)
    return np.where(curvature < 0, 0.5 * (before - after) / safe, 0.0)
