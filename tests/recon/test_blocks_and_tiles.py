"""What is done block by block and tile by tile comes out as if it were done at once; threads go as far as memory does."""

import numpy as np
import pytest

from recon.sweeps.black_level import MEDIAN_OF_FIVE, lit_floor, median_of_five, noise_floor
from recon.sweeps.decode_threads import threads_that_fit
from recon.sweeps.footprint import TILE_PX, coordinate_gradient
from recon.sweeps.noise import dark_variance
from recon.sweeps.peak_tracker import BLOCK_PIXELS, PeakTracker
from recon.sweeps.stripe_peak import NO_PEAK


def test_a_pixel_of_the_last_block_is_found_like_one_of_the_first() -> None:
    shape = (4, BLOCK_PIXELS // 3)
    lit = [0, BLOCK_PIXELS - 1, BLOCK_PIXELS, 4 * (BLOCK_PIXELS // 3) - 1]
    tracker = PeakTracker(np.full(shape, 9, np.uint8), half_width=1)
    for index in range(4):
        counts = np.full(shape, 5, np.uint8)
        counts.ravel()[lit[index]] = 200 + index
        tracker.feed(counts)
        assert tracker.brightest() == 200 + index
    found = tracker.finish().peak_index
    assert found[lit].tolist() == [0, 1, 2, 3]
    assert np.count_nonzero(found != NO_PEAK) == 4


def test_a_plane_has_the_same_slopes_on_both_sides_of_a_tile() -> None:
    row, col = np.mgrid[: TILE_PX + 40, : TILE_PX + 40].astype(np.float64)
    gradient, _ = coordinate_gradient(100 + 0.3 * col - 0.2 * row, np.ones(row.shape, bool), quantum_px=0.01)
    np.testing.assert_allclose(gradient, np.broadcast_to([0.3, -0.2], gradient.shape), atol=1e-6)


def test_a_small_patch_in_the_dark_has_slopes_and_pixels_that_noise_lit_have_none() -> None:
    row, col = np.mgrid[: TILE_PX + 40, : 2 * TILE_PX].astype(np.float64)
    patch = (row >= 100) & (row < 107) & (col >= 60) & (col < 67)
    # Each alone in its window, in the tile of the patch and in the one beside it.
    lone = (row % 40 == 20) & (col % 40 == 20) & ~patch
    gradient, _ = coordinate_gradient(100 + 0.3 * col - 0.2 * row, patch | lone, quantum_px=0.01)
    np.testing.assert_allclose(gradient[103, 63], [0.3, -0.2], atol=1e-6)
    assert np.isnan(gradient[lone & (np.hypot(row - 103, col - 63) > 20)]).all()


@pytest.mark.parametrize("jump_px", [-14.0, -9.0, -6.0])
def test_a_slope_beside_an_edge_is_that_of_the_pixels_own_side(jump_px: float) -> None:
    # Two planes that meet in a jump along an oblique line, seen in whole display pixels as footprints narrower than one are.
    row, col = np.mgrid[:60, :60].astype(np.float64)
    beyond = col + 0.5 * row > 45
    slopes = np.where(beyond[..., None], [0.261, 0.121], [0.389, -0.051])
    place = np.where(beyond, 80 + jump_px + 0.261 * col + 0.121 * row, 80 + 0.389 * col - 0.051 * row)
    gradient, _ = coordinate_gradient(np.rint(place), np.ones(place.shape, bool), quantum_px=1.0)
    from_edge_px = np.abs(col + 0.5 * row - 45) / np.hypot(1, 0.5)
    inside = (np.minimum(row, col) >= 7) & (np.maximum(row, col) < 53)
    off = np.abs(np.linalg.norm(gradient, axis=2) / np.linalg.norm(slopes, axis=2) - 1)
    assert np.quantile(off[inside & (from_edge_px > 3)], 0.95) < 0.15
    # There the edge goes through the smaller window as well.
    assert np.quantile(off[inside & (from_edge_px <= 3)], 0.9) < 0.25


def test_no_window_of_few_pixels_on_one_step_tells_the_slope_at_a_rim() -> None:
    # Two planes that meet in a jump, seen in whole display pixels through a round opening: slivers of it see one step alone.
    row, col = np.mgrid[:60, :60].astype(np.float64)
    beyond = col + 0.5 * row > 45
    place = np.where(beyond, 71 + 0.261 * col + 0.121 * row, 80 + 0.389 * col - 0.051 * row)
    seen = np.hypot(row - 29, col - 30) < 13
    gradient, _ = coordinate_gradient(np.rint(place), seen, quantum_px=1.0)
    level = np.linalg.norm(gradient, axis=2) < 0.02
    from_edge_px = np.abs(col + 0.5 * row - 45) / np.hypot(1, 0.5)
    assert not level[seen & (from_edge_px > 3)].any()


def test_a_slope_of_a_map_that_bends_is_that_of_the_pixel() -> None:
    row, col = np.mgrid[:40, :60].astype(np.float64)
    gradient, _ = coordinate_gradient(50 + 0.02 * (col - 30) ** 2 + 0.1 * row, np.ones(row.shape, bool), quantum_px=1.0)
    np.testing.assert_allclose(gradient[10:30, 15:46, 0], np.tile(0.04 * (np.arange(15, 46) - 30), (20, 1)), atol=1e-6)


def test_a_map_that_is_steep_is_no_edge() -> None:
    row, col = np.mgrid[:40, :60].astype(np.float64)
    # Up to six whole places from pixel to pixel.
    place = np.rint(500 - 60 * np.sqrt(70 - col) + 0.1 * row)
    gradient, _ = coordinate_gradient(place, np.ones(row.shape, bool), quantum_px=1.0)
    np.testing.assert_allclose(
        gradient[10:30, 8:58, 0], np.tile(30 / np.sqrt(70 - np.arange(8, 58)), (20, 1)), rtol=0.05
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_dark_variance_of_any_depth_is_that_of_half_the_difference(dtype: type) -> None:
    first, second = np.random.default_rng(8).integers(10, 14, (2, 100, 120)).astype(dtype)
    difference = second.astype(float) - first
    assert dark_variance(first, second) == pytest.approx(difference.var() / 2, rel=1e-12)


def test_the_black_level_of_five_photos_is_their_median() -> None:
    photos = np.random.default_rng(9).integers(0, 9, (5, 30, 40)).astype(np.uint16)
    np.testing.assert_array_equal(median_of_five(*photos), np.median(photos, axis=0))


def test_the_floor_of_lit_samples_stays_within_their_range() -> None:
    black = np.array([[0, 100, 250, 255]], np.uint8)
    np.testing.assert_array_equal(lit_floor(black, 8.7), [[8, 108, 255, 255]])


def test_threads_stop_where_memory_does_and_never_below_one() -> None:
    sweeps = {"cores": 16, "sweeps": 8, "pixels": 10_000_000, "sample_bytes": 1, "method": "full"}
    assert threads_that_fit(**sweeps, memory_bytes=10**9) == 1
    assert 1 < threads_that_fit(**sweeps, memory_bytes=8 * 10**9) < 8
    assert threads_that_fit(**sweeps, memory_bytes=10**12) == 8


@pytest.mark.parametrize("of_five", [False, True])
def test_noise_lights_one_dark_pixel_in_a_thousand_though_black_is_of_photos_too(of_five: bool) -> None:
    rng = np.random.default_rng(6)

    def photo() -> np.ndarray:
        return np.rint(rng.normal(40, 3, (200, 200))).astype(np.uint8)

    black = median_of_five(*(photo() for _ in range(5))) if of_five else photo()
    floor = noise_floor(black, 9.0 * (1 + (MEDIAN_OF_FIVE if of_five else 1.0)))
    lit = np.count_nonzero(np.any([photo() > floor for _ in range(300)], axis=0))
    # 4.5 sd are passed by 3.4 normal samples of a million; whole counts make the floor up to a quarter of an sd higher.
    assert 300 * 1.1e-6 < lit / floor.size < 300 * 3.6e-6


def test_whole_display_pixels_draw_no_slope_of_an_even_map() -> None:
    row, col = np.mgrid[:60, :60].astype(np.float64)
    place = 20 + 0.62 * col + 0.17 * row
    gradient, even = coordinate_gradient(np.rint(place), np.ones(place.shape, bool), quantum_px=1.0)
    inner = np.s_[8:-8, 8:-8]
    assert even[inner].all()
    off = np.linalg.norm(gradient, axis=2) / np.hypot(0.62, 0.17) - 1
    # A rounded place is off by 1/√12; over 15 columns of 15 pixels a slope by that / √(15 · 15 · (15² - 1) / 12).
    assert np.sqrt((off[inner] ** 2).mean()) < 2 / np.sqrt(12 * 15 * 15 * (15**2 - 1) / 12) / 0.62


def test_a_map_that_bends_is_not_called_even() -> None:
    row, col = np.mgrid[:60, :80].astype(np.float64)
    place = 50 + 0.04 * (col - 30) ** 2 + 0.1 * row
    _, even = coordinate_gradient(np.rint(place), np.ones(place.shape, bool), quantum_px=1.0)
    assert not even.any()
