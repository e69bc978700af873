"""Places within a display pixel: an affine or quadratic map, seen through device pixels by the law of the box footprint.

A footprint of width w about u lies within one device pixel, and says no more, where u is farther than w/2 from that one's edges;
else the shares of two device pixels tell u.
"""

import numpy as np
import pytest

from recon.sweeps.neighbour_places import told_by_neighbours

KNOWN_SD_PX = 0.01


def seen_through_device_pixels(true_px, reach_px, rng):
    """Return places and sds as curves of single pixels tell them."""
    middle = np.round(true_px)
    flat = np.abs(true_px - middle) < 0.5 - reach_px / 2
    place = np.where(flat, middle, true_px + rng.normal(0, KNOWN_SD_PX, true_px.shape))
    sd = np.where(flat, (1 - reach_px) / np.sqrt(12), KNOWN_SD_PX).astype(np.float32)
    return place, sd, flat


@pytest.mark.parametrize("reach_px", [0.15, 0.31, 0.49, 0.7])
@pytest.mark.parametrize("bend", [0.0, 2e-4])
def test_a_smooth_map_is_found_within_its_device_pixels(reach_px, bend):
    row, col = np.mgrid[:90, :97]
    true_px = 100.3 + 0.9 * reach_px * col + 0.1 * reach_px * row + bend * (col - 40) ** 2
    rng = np.random.default_rng(1)
    place, sd, flat = seen_through_device_pixels(true_px, reach_px, rng)
    reach = np.full(place.shape, reach_px, dtype=np.float32)

    told, told_sd = told_by_neighbours(place, sd, trusted=np.ones(place.shape, dtype=bool), reach_px=reach)

    inner = flat & (told_sd < sd)
    inner[:12], inner[-12:], inner[:, :12], inner[:, -12:] = False, False, False, False
    assert inner[12:-12, 12:-12].sum() > 0.95 * flat[12:-12, 12:-12].sum()
    error = (told - true_px)[inner]
    # Before, it was the sawtooth's (1 − w)/√12.
    assert np.sqrt((error**2).mean()) < KNOWN_SD_PX
    assert np.abs(error / told_sd[inner]).max() < 5
    np.testing.assert_array_equal(told[~flat], place[~flat])


def test_no_place_leaves_its_interval_or_is_led_across_a_jump():
    row, col = np.mgrid[:60, :80]
    true_px = 50 + 0.45 * col + 0.02 * row + np.where(col + row / 9 > 43, 3.37, 0.0)
    place, sd, _ = seen_through_device_pixels(true_px, 0.47, np.random.default_rng(2))
    told, told_sd = told_by_neighbours(
        place, sd, trusted=np.ones(place.shape, dtype=bool), reach_px=np.full(place.shape, 0.47, dtype=np.float32)
    )
    assert np.abs(told - place).max() <= (0.5 - 0.47 / 2) * 1.001
    moved = told != place
    assert np.abs((told - true_px)[moved] / told_sd[moved]).max() < 5
    assert moved[:, :20].any(axis=0).sum() > 10


def test_places_known_as_well_as_their_neighbours_stay():
    rng = np.random.default_rng(3)
    _, col = np.mgrid[:40, :40]
    place = 0.5 * col + rng.normal(0, 0.2, (40, 40))
    sd = rng.uniform(0.15, 0.25, place.shape).astype(np.float32)
    told, told_sd = told_by_neighbours(
        place, sd, trusted=np.ones(place.shape, dtype=bool), reach_px=np.full(place.shape, 0.5, dtype=np.float32)
    )
    np.testing.assert_array_equal(told, place)
    np.testing.assert_array_equal(told_sd, sd)


def test_pixels_that_are_not_trusted_neither_tell_nor_are_told():
    rng = np.random.default_rng(4)
    _, col = np.mgrid[:40, :46]
    true_px = 7.2 + 0.49 * col
    place, sd, _ = seen_through_device_pixels(true_px, 0.49, rng)
    trusted = rng.random(place.shape) > 0.2
    wrong = np.where(trusted, place, place + 0.3)
    reach = np.full(place.shape, 0.49, dtype=np.float32)
    told, _ = told_by_neighbours(wrong, sd, trusted=trusted, reach_px=reach)
    np.testing.assert_array_equal(told[~trusted], wrong[~trusted])
    assert np.abs((told - true_px)[trusted & (told != wrong)]).max() < 0.05


def test_a_map_whose_bend_changes_is_found_by_cubic_surfaces():
    row, col = np.mgrid[:60, :60].astype(float)
    slope = 0.22 + 3 * 4e-4 * (col - 30) ** 2
    true_px = 100.3 + 0.22 * col + 4e-4 * (col - 30) ** 3 + 0.05 * row
    reach = np.where(slope < 0.6, slope, np.nan)
    place, sd, flat = seen_through_device_pixels(true_px, np.minimum(slope, 1), np.random.default_rng(4))

    told, told_sd = told_by_neighbours(place, sd, trusted=np.ones(place.shape, dtype=bool), reach_px=reach)

    # Quadratic surfaces through 15 columns would leave 4e-4 · 7.5³ / 5 and more, three sds of what is known.
    inner = np.s_[15:-15, 15:-15]
    assert (told_sd < sd)[inner].sum() > 0.9 * flat[inner].sum()
    error = (told - true_px)[inner]
    assert np.sqrt((error**2).mean()) < 2 * KNOWN_SD_PX


def test_one_pixel_that_is_off_is_no_longer_sure_and_does_not_keep_its_neighbours_from_being_told():
    row, col = np.mgrid[:60, :60].astype(float)
    true_px = 100.3 + 0.42 * col + 0.05 * row
    place, sd, flat = seen_through_device_pixels(true_px, 0.45, np.random.default_rng(5))
    sure = np.argwhere(~flat[25:35, 25:35])[0] + 25
    place[tuple(sure)] += 0.4
    told, told_sd = told_by_neighbours(
        place, sd, trusted=np.ones(place.shape, dtype=bool), reach_px=np.full(place.shape, 0.45, dtype=np.float32)
    )
    about = np.s_[20:40, 20:40]
    assert (told_sd < sd)[about].sum() > 0.95 * flat[about].sum()
    assert np.abs((told - true_px) / told_sd)[about].max() < 5
