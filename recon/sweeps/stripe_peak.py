"""Find, while the photos of a sweep stream past, where each pixel was brightest; keep only a window about it.

A pixel that sees the display by two light paths is bright at two places, so the brightest maximum beyond that window is
kept as well. Memory is a few photos plus the windows, however long the sweep. The paper's parabola through the three brightest
samples is here too; the maximum-likelihood fit is in ``stripe_fit.py``, that of two peaks in ``two_paths.py``.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int32

Counts = np.ndarray  # [rows, cols] uint8 or uint16

NO_PEAK = -1
# Comparisons go block by block, so that what they make stays in a core's own cache; smaller blocks cost calls.
BLOCK_PIXELS = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class PeakWindows:
    """The samples about each pixel's brightest one.

    ``peak_index`` [pixels] is the stripe number of the brightest sample, ``NO_PEAK`` where no sample rose above the
    floor; ``samples`` [pixels, 2 * half_width + 1] are the counts about it, zero beyond the sweep's ends. ``second`` holds the
    windows about the brightest maximum outside those, where a sweep was searched for one.
    """

    peak_index: Int32[np.ndarray, " pixels"]
    samples: np.ndarray
    half_width: int
    photo_count: int
    second: "PeakWindows | None" = None

    def inside(self) -> np.ndarray:
        """Return which samples [pixels, window] exist, rather than lying beyond the sweep's ends."""
        place = self.peak_index[:, None] + np.arange(-self.half_width, self.half_width + 1)
        return (place >= 0) & (place < self.photo_count) & (self.peak_index[:, None] != NO_PEAK)


class PeakTracker:
    """Feed the photos of a sweep in order; ask for the windows at the end.

    A pixel's brightest sample is tested when the photos about it are at hand, so nothing needs mending afterwards, and
    pixels that never rise above ``floor`` [rows, cols] are never written.
    """

    def __init__(self, floor: Counts, *, half_width: int) -> None:
        if half_width < 1:
            raise ValueError("half_width: at least one neighbour on each side is needed")
        self._half_width = half_width
        self._first = _Peaks(floor.ravel(), half_width)
        self._second = _Peaks(floor.ravel(), half_width)
        nothing = np.zeros(floor.size, dtype=floor.dtype)
        self._ring = [nothing] * (2 * half_width + 1)
        self._nothing = nothing
        self._fed = 0
        self._pushed = 0
        self._shape = floor.shape

    def feed(self, counts: Counts) -> np.ndarray | None:
        """Take the next photo, which must stay untouched; return the array that is free to be reused."""
        self._fed += 1
        return self._push(counts.ravel())

    def finish(self) -> PeakWindows:
        """Test the photos still in the window and return the result."""
        for _ in range(self._half_width):
            self._push(self._nothing)
        first, second = self._first, self._second
        beyond = PeakWindows(second.index, second.samples, self._half_width, self._fed)
        return PeakWindows(first.index, first.samples, self._half_width, self._fed, beyond)

    def _push(self, counts: np.ndarray) -> np.ndarray | None:
        oldest = self._ring.pop(0)
        self._ring.append(counts)
        self._pushed += 1
        self._test(self._pushed - 1 - self._half_width)
        return None if oldest is self._nothing else oldest.reshape(self._shape)

    def _test(self, index: int) -> None:
        if index < 0 or index >= self._fed:
            return
        for start in range(0, self._nothing.size, BLOCK_PIXELS):
            self._test_block(slice(start, start + BLOCK_PIXELS), index)

    def _test_block(self, block: slice, index: int) -> None:
        before, centre, after = (self._ring[self._half_width + neighbour][block] for neighbour in (-1, 0, 1))
        candidate = centre > self._second.brightest[block]
        # Only a local maximum can be the brightest of all: a rising flank is not written again and again.
        if not candidate.any():
            return
        candidate &= centre >= before
        candidate &= centre >= after
        pixels = block.start + np.flatnonzero(candidate)
        first, second = self._first, self._second
        height = self._ring[self._half_width][pixels]
        brighter = height > first.brightest[pixels]
        apart = index - first.index[pixels] > self._half_width
        known = first.index[pixels] != NO_PEAK
        second.take_over(pixels[brighter & apart & known], first)
        first.write(pixels[brighter], height[brighter], index, self._ring)
        lesser = ~brighter & apart
        second.write(pixels[lesser], height[lesser], index, self._ring)


class _Peaks:
    """The brightest maximum so far of each pixel, its number, and the samples about it."""

    def __init__(self, floor: np.ndarray, half_width: int) -> None:
        self.brightest = floor.copy()
        self.index = np.full(floor.size, NO_PEAK, dtype=np.int32)
        # Pages of memory that no pixel is written to are never taken.
        self.samples = np.zeros((floor.size, 2 * half_width + 1), dtype=floor.dtype)

    def write(self, pixels: np.ndarray, height: np.ndarray, index: int, ring: list[np.ndarray]) -> None:
        self.brightest[pixels] = height
        self.index[pixels] = index
        for column, photo in enumerate(ring):
            self.samples[pixels, column] = photo[pixels]

    def take_over(self, pixels: np.ndarray, other: "_Peaks") -> None:
        self.brightest[pixels] = other.brightest[pixels]
        self.index[pixels] = other.index[pixels]
        self.samples[pixels] = other.samples[pixels]


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
