"""Find, while the photos of a sweep stream past, where each pixel was brightest; keep only a window about it.

A pixel that sees the display by two light paths is bright at two places, so the brightest maximum beyond that window is
kept as well. Memory is a few photos plus the windows, however long the sweep.
"""

import numpy as np

from recon.compiled import compiled
from recon.sweeps.stripe_peak import NO_PEAK, PeakWindows, SecondPeaks

Counts = np.ndarray  # [rows, cols] uint8 or uint16

# Of so many pixels the brightest is found first: mostly it is no brighter than what the darkest of them must exceed.
BLOCK_PIXELS = 128


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
        starts = np.arange(0, floor.size, BLOCK_PIXELS)
        self._least = np.minimum.reduceat(floor.ravel(), starts)
        # Of the photos whose test is to come: the brightest of each block.
        self._brightest = [np.zeros_like(self._least)] * half_width
        # Pages of memory that are not written to are never taken.
        self._found = np.empty(floor.size, dtype=np.int32)
        self._fed = 0
        self._pushed = 0
        self._shape = floor.shape

    def feed(self, counts: Counts) -> np.ndarray | None:
        """Take the next photo, which must stay untouched; return the array that is free to be reused."""
        self._fed += 1
        return self._push(counts.ravel())

    def brightest(self) -> int:
        """Return the brightest count of the photo that was fed last."""
        return int(self._brightest[-1].max())

    def finish(self) -> PeakWindows:
        """Test the photos still in the window and return the result."""
        for _ in range(self._half_width):
            self._push(self._nothing)
        return self._first.windows(self._fed, second=None if self._second is None else self._second.peaks(self._fed))

    def _push(self, counts: np.ndarray) -> np.ndarray | None:
        oldest = self._ring.pop(0)
        self._ring.append(counts)
        self._brightest.append(np.empty_like(self._least))
        write_brightest(counts, self._brightest[-1])
        self._pushed += 1
        index = self._pushed - 1 - self._half_width
        blocks = self._brightest.pop(0)
        if 0 <= index < self._fed:
            self._test(index, np.flatnonzero(blocks > self._least))
        return None if oldest is self._nothing else oldest.reshape(self._shape)

    def _test(self, index: int, blocks: np.ndarray) -> None:
        before, centre, after = (self._ring[self._half_width + neighbour] for neighbour in (-1, 0, 1))
        first, second = self._first, self._second
        brightest = (first if second is None else second).brightest
        count = brighter_peaks(blocks, before, centre, after, brightest, self._found)
        pixels = self._found[:count]
        height = centre.take(pixels)
        if second is not None:
            brighter = height > first.brightest.take(pixels)
            former = first.index.take(pixels)
            apart = index - former > self._half_width
            second.take_over(pixels[brighter & apart & (former != NO_PEAK)], first)
            lesser = ~brighter & apart
            second.write(pixels[lesser], height[lesser], index, self._ring)
            pixels, height = pixels[brighter], height[brighter]
        first.write(pixels, height, index, self._ring)


@compiled
def write_brightest(photo: np.ndarray, brightest: np.ndarray) -> None:
    """Write the brightest count of each block of a photo [pixels]."""
    for block in range(len(brightest)):
        # Indices without a sign: those with one are searched for negative ones, pixel by pixel.
        low = np.uintp(block * BLOCK_PIXELS)
        most = photo[low]
        for pixel in range(low, np.uintp(min((block + 1) * BLOCK_PIXELS, len(photo)))):
            most = max(most, photo[pixel])
        brightest[block] = most


@compiled
def brighter_peaks(
    blocks: np.ndarray,
    before: np.ndarray,
    centre: np.ndarray,
    after: np.ndarray,
    brightest: np.ndarray,
    found: np.ndarray,
) -> int:
    """Write which pixels in some blocks of a photo are brighter than ever, and no darker than before and after; return how many.

    Only a local maximum can be the brightest of all: a rising flank is not written again and again.
    """
    count = 0
    for number in range(len(blocks)):
        low = blocks[number] * BLOCK_PIXELS
        block = range(np.uintp(low), np.uintp(min(low + BLOCK_PIXELS, len(centre))))
        some = False
        for pixel in block:
            some |= centre[pixel] > brightest[pixel]
        if some:
            for pixel in block:
                height = centre[pixel]
                if height > brightest[pixel] and height >= before[pixel] and height >= after[pixel]:
                    found[count] = pixel
                    count += 1
    return count


@compiled
def copy_samples(photo: np.ndarray, pixels: np.ndarray, samples: np.ndarray, rows: np.ndarray, column: int) -> None:
    """Write the counts of some pixels of a photo into their rows of a column of the samples."""
    for number in range(len(pixels)):
        samples[np.uintp(rows[number]), np.uintp(column)] = photo[np.uintp(pixels[number])]


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
        for column, photo in enumerate(ring):
            copy_samples(photo, pixels, self.samples, rows, column)

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
        pixels = np.flatnonzero(self._row != NO_PEAK).astype(np.int32)
        rows = self._row[pixels]
        index, samples = self.index[rows], self.samples[rows]
        return SecondPeaks(pixels, PeakWindows(index, samples, samples.shape[1] // 2, photo_count))
