"""The noise of peaks that no fit shows: of pixels that one photo alone lit, and of the dark samples beside bright ones."""

import numpy as np

from recon.compiled import compiled
from recon.sweeps.noise import CHI_SQUARE_MEDIAN, FEWEST_IN_BIN
from recon.sweeps.stripe_peak import PeakWindows

# A pixel is lit in one photo alone where the photos beside it hold less than this share of its light.
LONE_SHARE = 0.01
LARGEST_STEP_SHARE = 0.1
# Peaks of this share of the median one are bright; so many pixels tell the noise beside them.
BRIGHT_SHARE = 0.5
BESIDE_PIXELS = 100_000
BAND_ROWS = 128


def lone_peak_variance(
    windows: PeakWindows, black: np.ndarray, *, clipped: int, dark_variance: float
) -> tuple[float, float] | None:
    """Return height and variance of the samples of pixels that the stripe lit in a single photo, or None where they are few.

    A fit follows such a sample whatever its noise. But neighbours lit by the same stripe alone are lit alike, so that their
    difference tells the variance of a fully lit sample. ``black`` is [rows, cols].
    """
    rows, columns = black.shape
    height, square = np.empty(BAND_ROWS * columns, dtype=np.float32), np.empty(BAND_ROWS * columns)
    heights, squares = [], []
    dark_reach = 3 * float(np.sqrt(dark_variance))
    seen = (windows.peak_index, windows.samples, black.ravel())
    for low in range(0, rows, BAND_ROWS):
        count = write_lone_pairs(low, min(low + BAND_ROWS, rows), columns, *seen, clipped, dark_reach, height, square)
        heights.append(height[:count].copy())
        squares.append(square[:count].copy())
    height, square = np.concatenate(heights), np.concatenate(squares)
    if len(height) < FEWEST_IN_BIN:
        return None
    return float(np.median(height)), float(np.median(square)) / CHI_SQUARE_MEDIAN


@compiled
def write_lone_pairs(
    low: int,
    high: int,
    columns: int,
    peak_index: np.ndarray,
    samples: np.ndarray,
    black: np.ndarray,
    clipped: int,
    dark_reach: float,
    heights: np.ndarray,
    squares: np.ndarray,
) -> int:
    """Write mean height and half the squared difference of each pair of such neighbours in some rows; return how many."""
    middle = np.uintp(samples.shape[1] // 2)
    share, step_share, half = np.float32(LONE_SHARE), np.float32(LARGEST_STEP_SHARE), np.float32(0.5)
    count = 0
    for row in range(low, high):
        # Of the pixel before: the photo that alone lit it, if one did, and the height.
        former, former_peak = -1, np.float32(0)
        for pixel in range(np.uintp(row * columns), np.uintp((row + 1) * columns)):
            photo = peak_index[pixel]
            dark = np.float32(black[pixel])
            peak = np.float32(samples[pixel, middle]) - dark
            beside = np.float32(max(samples[pixel, middle - 1], samples[pixel, middle + 1])) - dark
            lone = photo >= 0 and samples[pixel, middle] < clipped and beside < max(float(share * peak), dark_reach)
            # A pixel that sees its stripe through a rim is darker than its neighbour: not noise.
            if lone and photo == former and abs(peak - former_peak) < step_share * (peak + former_peak):
                heights[count] = half * (peak + former_peak)
                difference = float(peak - former_peak)
                squares[count] = 0.5 * (difference * difference)
                count += 1
            former, former_peak = (photo if lone else -1), peak
    return count


def beside_peak_variance(windows: PeakWindows, black: np.ndarray) -> float | None:
    """Return the variance of the dark samples next to a bright peak, or None where next to peaks hardly any is dark.

    A stripe takes no light away, so what lies below the rest of the window there is noise; as much of it lies above, where a fit
    takes it for light. Compressed photos are noisier there than elsewhere: blocks with an edge in them ring.
    """
    middle = windows.half_width
    number = windows.peak_index
    lit = np.flatnonzero((number >= middle) & (number < windows.photo_count - middle))
    lit = lit[:: max(len(lit) // BESIDE_PIXELS, 1)]
    if middle < 2 or len(lit) == 0:
        return None
    samples = windows.samples[lit].astype(np.float32)
    peak = samples[:, middle] - black[lit]
    samples = samples[peak >= BRIGHT_SHARE * np.median(peak)]
    rest = np.delete(samples, [middle - 1, middle, middle + 1], axis=1)
    height = samples[:, [middle - 1, middle + 1]] - rest.mean(axis=1, keepdims=True)
    below = height[height < 0].astype(np.float64)
    if len(below) < FEWEST_IN_BIN:
        return None
    # The mean of the rest has noise of its own.
    return float((below**2).mean() - np.median(rest.var(axis=1, ddof=1)) / rest.shape[1])
