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
        self._shape = floor.shape
        # The latest photos: each takes the place of the oldest. Before the sweep it is dark.
        self._ring = np.zeros((2 * half_width + 1, floor.size), dtype=floor.dtype)
        self._first = _Peaks(floor.ravel(), half_width)
        self._second = _FewPeaks(floor.ravel(), half_width) if second else None
        starts = np.arange(0, floor.size, BLOCK_PIXELS)
        self._least = np.minimum.reduceat(floor.ravel(), starts)
        # Of the photos whose test is to come: the brightest of each block.
        self._brightest = [np.zeros_like(self._least)] * half_width
        self._fed = 0
        self._pushed = 0

    def feed(self, counts: Counts) -> Counts:
        """Take the next photo; return the array that the one after it may be written to, which spares copying it."""
        place = self._ring[self._pushed % len(self._ring)]
        if not np.may_share_memory(counts, place):
            np.copyto(place, counts.ravel(), casting="no")
        self._fed += 1
        self._push(place)
        return self._ring[self._pushed % len(self._ring)].reshape(self._shape)

    def brightest(self) -> int:
        """Return the brightest count of the photo that was fed last."""
        return int(self._brightest[-1].max())

    def finish(self) -> PeakWindows:
        """Test the photos still in the window and return the result."""
        for _ in range(self._half_width):
            place = self._ring[self._pushed % len(self._ring)]
            place[:] = 0
            self._push(place)
        return self._first.windows(self._fed, second=None if self._second is None else self._second.peaks(self._fed))

    def _push(self, counts: np.ndarray) -> None:
        self._brightest.append(np.empty_like(self._least))
        write_brightest(counts, self._brightest[-1])
        self._pushed += 1
        index = self._pushed - 1 - self._half_width
        blocks = self._brightest.pop(0)
        if 0 <= index < self._fed:
            self._test(index, np.flatnonzero(blocks > self._least))

    def _test(self, index: int, blocks: np.ndarray) -> None:
        # From the oldest to the latest.
        places = (self._pushed + np.arange(len(self._ring))) % len(self._ring)
        first, second = self._first, self._second
        if second is None:
            write_peaks(blocks, self._ring, places, index, first.brightest, first.index, first.samples)
        else:
            second.count = write_two_peaks(
                blocks,
                self._ring,
                places,
                index,
                first.brightest,
                first.index,
                first.samples,
                second.brightest,
                second.index,
                second.samples,
                second.row,
                second.count,
            )


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
def write_peaks(
    blocks: np.ndarray,
    ring: np.ndarray,
    places: np.ndarray,
    index: int,
    brightest: np.ndarray,
    number: np.ndarray,
    samples: np.ndarray,
) -> None:
    """Let the photo in the middle, whose number is ``index``, be the brightest of those pixels of some blocks that it is.

    ``ring`` [photos, pixels] holds the photos, the oldest first in the order of ``places``. Brightest count, number of the photo
    and the counts in all of them are written where a pixel is brighter than ever, and no darker than before and after.
    """
    found = np.empty(BLOCK_PIXELS, dtype=np.bool_)
    for each in range(len(blocks)):
        low = np.uintp(blocks[each] * BLOCK_PIXELS)
        for k in range(_find_peaks(low, ring, places, brightest, found)):
            if found[k]:
                pixel = low + k
                brightest[pixel] = ring[places[len(places) // 2], pixel]
                number[pixel] = index
                _copy_samples(ring, places, pixel, samples, pixel)


@compiled
def write_two_peaks(
    blocks: np.ndarray,
    ring: np.ndarray,
    places: np.ndarray,
    index: int,
    brightest: np.ndarray,
    number: np.ndarray,
    samples: np.ndarray,
    second_brightest: np.ndarray,
    second_number: np.ndarray,
    second_samples: np.ndarray,
    row_of: np.ndarray,
    rows: int,
) -> int:
    """Do the same for the brightest and for the second peak, which lies beyond the window about the first; return its rows.

    Numbers and samples of second peaks have rows of their own: ``row_of`` [pixels] tells which, from 1 on; ``rows`` are taken.
    """
    found = np.empty(BLOCK_PIXELS, dtype=np.bool_)
    half_width = len(places) // 2
    for each in range(len(blocks)):
        low = np.uintp(blocks[each] * BLOCK_PIXELS)
        for k in range(_find_peaks(low, ring, places, second_brightest, found)):
            if not found[k]:
                continue
            pixel = low + k
            height, former = ring[places[half_width], pixel], number[pixel]
            brighter, apart = height > brightest[pixel], index - former > half_width
            if apart and (former >= 0 or not brighter):
                if row_of[pixel] == 0:
                    rows += 1
                    row_of[pixel] = rows
                row = np.uintp(row_of[pixel] - 1)
                if brighter:
                    # The peak before this one becomes the second.
                    second_brightest[pixel], second_number[row] = brightest[pixel], former
                    for column in range(np.uintp(len(places))):
                        second_samples[row, column] = samples[pixel, column]
                else:
                    second_brightest[pixel], second_number[row] = height, index
                    _copy_samples(ring, places, pixel, second_samples, row)
            if brighter:
                brightest[pixel], number[pixel] = height, index
                _copy_samples(ring, places, pixel, samples, pixel)
    return rows


@compiled
def _find_peaks(
    low: np.uintp, ring: np.ndarray, places: np.ndarray, brightest: np.ndarray, found: np.ndarray
) -> np.uintp:
    """Write which pixels of a block are brighter than ever, and no darker than before and after; return how many to look at.

    Only a local maximum can be the brightest of all: a rising flank is not written again and again.
    """
    middle = len(places) // 2
    before, centre, after = ring[places[middle - 1]], ring[places[middle]], ring[places[middle + 1]]
    size = min(np.uintp(BLOCK_PIXELS), np.uintp(len(brightest)) - low)
    some = False
    for k in range(size):
        some |= centre[low + k] > brightest[low + k]
    if not some:
        return np.uintp(0)
    for k in range(size):
        height = centre[low + k]
        found[k] = (height > brightest[low + k]) & (height >= before[low + k]) & (height >= after[low + k])
    return size


@compiled
def _copy_samples(ring: np.ndarray, places: np.ndarray, pixel: np.uintp, samples: np.ndarray, row: np.uintp) -> None:
    """Write the counts of a pixel in all photos of the ring into a row of the samples."""
    for column in range(np.uintp(len(places))):
        samples[row, column] = ring[np.uintp(places[column]), pixel]


class _Peaks:
    """The brightest maximum so far of each pixel, its number, and the samples about it."""

    def __init__(self, floor: np.ndarray, half_width: int) -> None:
        self.brightest = floor.copy()
        self.index = np.full(floor.size, NO_PEAK, dtype=np.int32)
        # Pages of memory that no pixel is written to are never taken.
        self.samples = np.zeros((floor.size, 2 * half_width + 1), dtype=floor.dtype)

    def windows(self, photo_count: int, *, second: SecondPeaks | None = None) -> PeakWindows:
        """Return what was found in so many photos."""
        return PeakWindows(self.index, self.samples, self.samples.shape[1] // 2, photo_count, second)


class _FewPeaks:
    """The same where few pixels have any: they get rows as they come, so that noise here and there takes no memory everywhere."""

    def __init__(self, floor: np.ndarray, half_width: int) -> None:
        self.brightest = floor.copy()
        # Of each pixel the row, from 1 on; of each row the number and the samples.
        self.row = np.zeros(floor.size, dtype=np.int32)
        self.index = np.zeros(floor.size, dtype=np.int32)
        self.samples = np.zeros((floor.size, 2 * half_width + 1), dtype=floor.dtype)
        self.count = 0

    def peaks(self, photo_count: int) -> SecondPeaks:
        """Return what was found in so many photos."""
        pixels = np.flatnonzero(self.row).astype(np.int32)
        rows = self.row[pixels] - 1
        index, samples = self.index[rows], self.samples[rows]
        return SecondPeaks(pixels, PeakWindows(index, samples, samples.shape[1] // 2, photo_count))
