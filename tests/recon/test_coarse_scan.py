"""The coarse scan: bars in Gray code, read back from photos that a pinhole model with blur and noise makes."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.patterns.coarse_scan import range_of_bars, scan_bits, scan_levels, seen_bars
from recon.sessions.manifest import StripePattern


def pattern(*, first_px: float = 20.0, step_px: float = 4.0, count: int = 200, width_px: float = 12.0) -> StripePattern:
    return StripePattern(profile="raised_cosine", width_px=width_px, first_px=first_px, step_px=step_px, count=count)


DEVICE_PX = 900
ROWS, COLS = 40, 300


def photos(
    place_px: np.ndarray, one: StripePattern, *, noise: float, seed: int = 1
) -> tuple[list, np.ndarray, np.ndarray]:
    """Photograph bits, white and black with pixels that see 3 device pixels about ``place_px`` [rows, cols] (NaN: dark)."""
    rng = np.random.default_rng(seed)

    def photo(levels: np.ndarray) -> np.ndarray:
        total = np.zeros(place_px.shape)
        for offset in (-1, 0, 1):
            column = np.clip(np.rint(np.nan_to_num(place_px) + offset), 0, DEVICE_PX - 1).astype(int)
            total += levels[column] / 255 / 3
        light = np.where(np.isfinite(place_px), 180 * total, 0.0)
        return np.clip(np.rint(10 + light + rng.normal(0, noise, light.shape)), 0, 255).astype(np.uint8)

    bits = [photo(scan_levels(one, bit, device_px=DEVICE_PX)) for bit in range(scan_bits(one))]
    return bits, photo(np.full(DEVICE_PX, 255)), photo(np.zeros(DEVICE_PX))


def ramp(low_px: float, high_px: float) -> np.ndarray:
    """A disc that sees the display from ``low_px`` to ``high_px``, dark beside it."""
    row, col = np.mgrid[:ROWS, :COLS]
    place = low_px + (high_px - low_px) * (col - 50) / (COLS - 101)
    return np.where((col >= 50) & (col < COLS - 50) & (row > 5) & (row < 35), place, np.nan)


def test_bars_side_by_side_differ_in_one_bit_and_the_display_beyond_is_dark() -> None:
    one = pattern()
    frames = np.stack([scan_levels(one, bit, device_px=DEVICE_PX) > 0 for bit in range(scan_bits(one))])
    codes = [tuple(frames[:, column]) for column in range(DEVICE_PX)]
    assert len(set(codes)) == 2 ** scan_bits(one)
    inside = range(18, 818)
    for left, right in itertools.pairwise(inside):
        assert sum(a != b for a, b in zip(codes[left], codes[right], strict=True)) <= 1
    assert not frames[:, :18].any()
    assert not frames[:, 818:].any()


@given(low=st.floats(20, 400), span=st.floats(30, 400))
def test_every_stripe_that_a_pixel_sees_lies_within_the_range_and_little_else(low: float, span: float) -> None:
    one = pattern()
    bits, white, black = photos(ramp(low, low + span), one, noise=1.5)
    found = range_of_bars(seen_bars(bits, white=white, black=black), one, half_window=5)
    assert found is not None
    first, last = (low - one.first_px) / one.step_px, (low + span - one.first_px) / one.step_px
    # The window of photos that a place is made from: half the stripe is 1.5 steps, rounded up, and three beyond.
    assert found.first_index <= max(first - 5, 0)
    assert found.last_index >= min(last + 5, one.count - 1)
    # Three bars of 200/63 steps at the most: where the bar begins, its margin, and a pixel on an edge.
    assert found.first_index >= first - 5 - 3 * 200 / 63 - 1
    assert found.last_index <= last + 5 + 3 * 200 / 63 + 1


def test_a_region_of_the_photo_leaves_out_what_is_seen_beside_it() -> None:
    one = pattern()
    place = np.broadcast_to(np.linspace(30, 780, COLS), (ROWS, COLS))
    bits, white, black = photos(place, one, noise=1.5)
    whole = range_of_bars(seen_bars(bits, white=white, black=black), one, half_window=5)
    part = range_of_bars(seen_bars(bits, white=white, black=black, region=(140, 0, 160, ROWS - 1)), one, half_window=5)
    assert whole is not None
    assert part is not None
    assert whole.last_index - whole.first_index > 180
    assert part.last_index - part.first_index < 40


def test_noise_alone_finds_nothing() -> None:
    one = pattern()
    bits, white, black = photos(np.full((ROWS, COLS), np.nan), one, noise=3.0)
    assert range_of_bars(seen_bars(bits, white=white, black=black), one, half_window=5) is None


def test_single_pixels_of_nonsense_do_not_widen_the_range() -> None:
    one = pattern()
    place = ramp(300, 400)
    bits, white, black = photos(place, one, noise=1.5)
    clean = range_of_bars(seen_bars(bits, white=white, black=black), one, half_window=5)
    rng = np.random.default_rng(5)
    for row, col in rng.integers([6, 60], [34, 240], (40, 2)):
        for counts in bits:
            counts[row, col] = rng.choice([10, 190])
    spoiled = range_of_bars(seen_bars(bits, white=white, black=black), one, half_window=5)
    assert clean is not None
    assert spoiled is not None
    assert (spoiled.first_index, spoiled.last_index) == (clean.first_index, clean.last_index)


def test_photos_of_sixteen_bits_are_read_alike() -> None:
    one = pattern()
    bits, white, black = photos(ramp(300, 400), one, noise=1.5)
    wide = [counts.astype(np.uint16) * 257 for counts in (*bits, white, black)]
    np.testing.assert_array_equal(
        seen_bars(wide[:-2], white=wide[-2], black=wide[-1]), seen_bars(bits, white=white, black=black)
    )


@pytest.mark.parametrize(("count", "width_px"), [(3, 1.0), (4, 12.0), (8, 60.0)])
def test_a_sweep_too_short_to_gain_is_not_scanned(count: int, width_px: float) -> None:
    assert scan_bits(pattern(count=count, width_px=width_px, step_px=1.0)) == 0
