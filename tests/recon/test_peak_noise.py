"""The noise of peaks that no fit shows, against the variance that the samples were drawn with."""

import numpy as np
import pytest

from recon.sweeps.peak_noise import lone_peak_variance
from recon.sweeps.stripe_peak import NO_PEAK, PeakWindows

ROWS, COLUMNS = 200, 240
# Differences are whole counts, of which the median is one: the noise is many of them.
BLACK, TOP, SD = 40, 2000.0, 50.0


def windows_of(counts: np.ndarray, photo: np.ndarray) -> PeakWindows:
    return PeakWindows(photo.ravel().astype(np.int32), np.rint(counts).astype(np.uint16), 3, 64)


def lone_counts(rng: np.random.Generator) -> np.ndarray:
    counts = np.full((ROWS * COLUMNS, 7), float(BLACK))
    counts[:, 3] += TOP + rng.normal(0, SD, len(counts))
    return counts


def variance_of(windows: PeakWindows, *, clipped: int = 65534) -> tuple[float, float] | None:
    return lone_peak_variance(windows, np.full((ROWS, COLUMNS), BLACK, np.uint16), clipped=clipped, dark_variance=1.0)


def test_neighbours_lit_by_one_photo_alone_tell_the_variance_of_a_lit_sample() -> None:
    rng = np.random.default_rng(1)
    # Stripes of five columns, each lit by a photo of its own; in some rows there is no light.
    photo = np.broadcast_to(10 + np.arange(COLUMNS) // 5, (ROWS, COLUMNS)).copy()
    photo[::7] = NO_PEAK
    counts = lone_counts(rng)
    # One pixel in nine sees its stripe through a rim, and one in eleven two photos: neither is noise.
    counts[::9, 3] = BLACK + 0.5 * TOP
    counts[::11, 4] = BLACK + 0.3 * TOP
    found = variance_of(windows_of(counts, photo))
    assert found is not None
    height, variance = found
    assert height == pytest.approx(TOP, rel=1e-3)
    # Some 25,000 pairs: the relative sd of a variance by the median is 2.3 · √(2 / 25,000) / √2, below two per cent.
    assert variance == pytest.approx(SD**2 + 1 / 12, rel=0.06)


def test_neighbours_lit_by_different_photos_are_no_pairs() -> None:
    photo = np.broadcast_to(10 + np.arange(COLUMNS) % 2, (ROWS, COLUMNS))
    assert variance_of(windows_of(lone_counts(np.random.default_rng(2)), photo)) is None


def test_the_last_pixel_of_a_row_is_no_neighbour_of_the_first_of_the_next() -> None:
    photo = np.full((ROWS, COLUMNS), NO_PEAK)
    photo[:, 0] = photo[:, -1] = 10
    assert variance_of(windows_of(lone_counts(np.random.default_rng(3)), photo)) is None


def test_clipped_samples_tell_no_noise() -> None:
    photo = np.full((ROWS, COLUMNS), 10)
    assert variance_of(windows_of(lone_counts(np.random.default_rng(4)), photo), clipped=int(BLACK + TOP / 2)) is None
