"""The counts that a pixel shows without the stripe, and how far above them a sample is light and no noise."""

from collections.abc import Callable

import numpy as np

from recon.sessions.manifest import CaptureSet
from recon.sessions.photos import Counts
from recon.sessions.session import Session
from recon.sweeps.noise import ROUNDING_VARIANCE, dark_variance
from recon.sweeps.photo_stream import black_photo, has_black

# A peak is one that noise alone would show in one dark sample of a thousand million.
PEAK_SIGMA = 6.0
LEAST_PEAK_COUNTS = 2.0
# Noise alone shows a stripe in one dark sample of 300,000, in one dark pixel of a thousand in a sweep of the paper's length; the
# fit then finds no curve there. A higher floor would lose faint light, of which there is far more.
STRIPE_SIGMA = 4.5
# Fewer different counts may have a common step by chance.
FEWEST_COUNTS = 16
# Variance of the median of five normal samples, over that of one (David and Nagaraja, Order Statistics, 3rd ed., 2003).
MEDIAN_OF_FIVE = 0.2868


def black_level(
    session: Session, capture_set: CaptureSet, numbers: range, *, photo: Callable[[int], Counts]
) -> tuple[np.ndarray, float, float]:
    """Return the counts without the stripe, the variance of one dark sample and that of one of these counts.

    The black photo where there is one; otherwise the median of five photos spread over the sweep, whose photos have these
    ``numbers``.
    """
    first, last = photo(numbers[0]), photo(numbers[-1])
    step = 1 if first.dtype == np.uint8 else step_of_counts(photo(middle_of(numbers)))
    # Noise below the step is rounded away, and shows again in a sample here and there.
    variance = max(dark_variance(first, last), ROUNDING_VARIANCE * step**2)
    if has_black(session, capture_set):
        return black_photo(session, capture_set), variance, variance
    between = (photo(numbers[round(share * (len(numbers) - 1))]) for share in (0.25, 0.5, 0.75))
    return median_of_five(first, last, *between), variance, MEDIAN_OF_FIVE * variance


def middle_of(numbers: range) -> int:
    """Return the number of the photo in the middle of a sweep, where most likely there is light."""
    return numbers[round(0.5 * (len(numbers) - 1))]


def step_of_counts(counts: Counts) -> int:
    """Return the step in which a photo's counts come: 257 for 8 bits stretched to 16, and 1 where they tell none."""
    if counts.dtype == np.uint8:
        return 1
    seen = np.zeros(np.iinfo(counts.dtype).max + 1, dtype=bool)
    seen[counts] = True
    different = np.flatnonzero(seen)
    return int(np.gcd.reduce(np.diff(different))) if len(different) >= FEWEST_COUNTS else 1


def median_of_five(a: Counts, b: Counts, c: Counts, d: Counts, e: Counts) -> Counts:
    """Return the median of five photos [rows, cols], pixel by pixel."""
    # The two smaller of each pair's larger and smaller ones cannot be the median of the four; with the fifth, three remain.
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.maximum(np.minimum(low, high), np.minimum(e, np.maximum(low, high)))


def noise_floor(black: Counts, variance: float) -> Counts:
    """Return the counts [rows, cols] that noise hardly reaches; ``variance`` is that of a dark sample and of black together."""
    return lit_floor(black, max(STRIPE_SIGMA * np.sqrt(variance), LEAST_PEAK_COUNTS))


def reach_floor(black: Counts, variance: float) -> Counts:
    """Return the counts [rows, cols] above which a few photos tell how far curves reach; ``variance`` is that of a dark sample.

    The widest curves are the faintest, so that black's own noise is left out: a few peaks of noise do less harm than to miss
    them.
    """
    return lit_floor(black, max(PEAK_SIGMA * np.sqrt(variance), LEAST_PEAK_COUNTS))


def lit_floor(black: Counts, rise: float) -> Counts:
    """Return the counts [rows, cols] that a lit sample exceeds: ``rise`` above black, within the range of the samples."""
    top = np.iinfo(black.dtype).max
    up = black.dtype.type(min(int(rise), top))
    return np.minimum(black, black.dtype.type(top - up)) + up
