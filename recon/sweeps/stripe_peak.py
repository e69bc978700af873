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
    """The windows about a second maximum, which few pixels have: ``row`` [pixels] is that of a pixel, ``NO_PEAK`` for most."""

    row: Int32[np.ndarray, " pixels"]
    windows: PeakWindows


class PeakTracker:
    """Feed the photos of a sweep in order; ask for the windows at the end.

    A pixel's brightest sample is tested when the photos about it are at hand, so nothing needs mending afterwards, and
    pixels that never rise above ``floor`` [rows, cols] are never written. With ``second`` the windows hold the second peaks too.
    """

    def __init__(self, floor: Counts, *, half_width: int, second: bool = True) -> None:
        if half_width < 1:
            raise ValueError("half_width: at least one neighbour on each side is needed")
        self._half_width = half_width
        self._first = _Peaks(floor.ravel(), half_width)
        self._second = _FewPeaks(floor.ravel(), half_width) if second else None
        nothing = np.zeros(floor.size, dtype=floor.dtype)
        self._ring = [nothing] * (2 * half_width + 1)
        self._nothing = nothing
        self._above = np.zeros(BLOCK_PIXELS, dtype=bool)
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
        return self._first.windows(self._fed, second=None if self._second is None else self._second.peaks(self._fed))

    def _push(self, counts: np.ndarray) -> np.ndarray | None:
        oldest = self._ring.pop(0)
        self._ring.append(counts)
        self._pushed += 1
        index = self._pushed - 1 - self._half_width
        if 0 <= index < self._fed:
            self._test(index)
        return None if oldest is self._nothing else oldest.reshape(self._shape)

    def _test(self, index: int) -> None:
        before, centre, after = (self._ring[self._half_width + neighbour] for neighbour in (-1, 0, 1))
        first, second = self._first, self._second
        pixels = self._brighter(centre, (first if second is None else second).brightest)
        height = centre.take(pixels)
        # Only a local maximum can be the brightest of all: a rising flank is not written again and again.
        highest = (height >= before.take(pixels)) & (height >= after.take(pixels))
        pixels, height = pixels[highest], height[highest]
        if second is not None:
            brighter = height > first.brightest.take(pixels)
            former = first.index.take(pixels)
            apart = index - former > self._half_width
            second.take_over(pixels[brighter & apart & (former != NO_PEAK)], first)
            lesser = ~brighter & apart
            second.write(pixels[lesser], height[lesser], index, self._ring)
            pixels, height = pixels[brighter], height[brighter]
        first.write(pixels, height, index, self._ring)

    def _brighter(self, centre: np.ndarray, brightest: np.ndarray) -> np.ndarray:
        """Return the pixels that are brighter than ever."""
        found = []
        for start in range(0, centre.size, BLOCK_PIXELS):
            block = slice(start, start + BLOCK_PIXELS)
            part = centre[block]
            np.greater(part, brightest[block], out=self._above[: len(part)])
            self._above[len(part) :] = False
            found.append(start + _true_places(self._above))
        return np.concatenate(found)


def _true_places(values: np.ndarray) -> np.ndarray:
    """Return where the values are true: ``flatnonzero``, but several times as fast where few of them are.

    Eight values are one word of 64 bits, and eight of these answers are one again.
    """
    some = values.view(np.uint64) != 0
    words = np.flatnonzero(some.view(np.uint64) != 0)
    place = np.flatnonzero(values.reshape(-1, 64)[words])
    return words[place >> 6] * 64 + (place & 63)


class _Peaks:
    """The brightest maximum so far of each pixel, its number, and the samples about it."""

    def __init__(self, floor: np.ndarray, half_width: int) -> None:
        self.brightest = floor.copy()
        self.index = np.full(floor.size, NO_PEAK, dtype=np.int32)
        # Pages of memory that no pixel is written to are never taken.
        self.samples = np.zeros((floor.size, 2 * half_width + 1), dtype=floor.dtype)

    def rows(self, pixels: np.ndarray) -> np.ndarray:
        """Return in which rows of ``index`` and ``samples`` these pixels are written."""
        return pixels

    def write(self, pixels: np.ndarray, height: np.ndarray, index: int, ring: list[np.ndarray]) -> None:
        """Let photo ``index`` be the brightest of these pixels."""
        rows = self.rows(pixels)
        self.brightest[pixels] = height
        self.index[rows] = index
        window = np.empty((len(pixels), len(ring)), dtype=self.samples.dtype)
        for column, photo in enumerate(ring):
            window[:, column] = photo.take(pixels)
        self.samples[rows] = window

    def windows(self, photo_count: int, *, second: SecondPeaks | None = None) -> PeakWindows:
        """Return what was found in so many photos."""
        return PeakWindows(self.index, self.samples, self.samples.shape[1] // 2, photo_count, second)


class _FewPeaks(_Peaks):
    """The same where few pixels have any: they get rows as they come, so that noise here and there takes no memory everywhere."""

    def __init__(self, floor: np.ndarray, half_width: int) -> None:
        super().__init__(floor, half_width)
        self.index = np.zeros(floor.size, dtype=np.int32)
        self._row = np.full(floor.size, NO_PEAK, dtype=np.int32)
        self._count = 0

    def rows(self, pixels: np.ndarray) -> np.ndarray:
        """Return the rows of these pixels, new ones where they had none."""
        rows = self._row.take(pixels)
        new = np.flatnonzero(rows == NO_PEAK)
        rows[new] = np.arange(self._count, self._count + len(new))
        self._row[pixels[new]] = rows[new]
        self._count += len(new)
        return rows

    def take_over(self, pixels: np.ndarray, other: _Peaks) -> None:
        """Take what the other one holds of these pixels."""
        rows = self.rows(pixels)
        self.brightest[pixels] = other.brightest[pixels]
        self.index[rows] = other.index[pixels]
        self.samples[rows] = other.samples[pixels]

    def peaks(self, photo_count: int) -> SecondPeaks:
        """Return what was found in so many photos."""
        index, samples = self.index[: self._count], self.samples[: self._count]
        return SecondPeaks(self._row, PeakWindows(index, samples, samples.shape[1] // 2, photo_count))


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
