"""Pixels at an edge of the light: the share of a square pixel that a straight edge leaves, in closed form."""

import numpy as np
import pytest

from recon.sweeps.half_seen import BAND_ROWS, half_seen_of, less_than_half_seen


def share_lit(shape: tuple[int, int], edge_px: float) -> np.ndarray:
    """Return the share of each pixel's area left of an upright edge at this column."""
    col = np.arange(shape[1])
    return np.broadcast_to(np.clip(edge_px - (col - 0.5), 0.0, 1.0), shape)


@pytest.mark.parametrize("edge_px", [19.6, 19.9, 20.1, 20.4])
def test_a_pixel_counts_as_half_dark_exactly_where_its_centre_is(edge_px: float) -> None:
    share = share_lit((30, 40), edge_px)
    half = less_than_half_seen(np.where(share > 0, 200.0 * share, np.nan), share > 0)
    col = np.arange(40)
    np.testing.assert_array_equal(half, np.broadcast_to((share[0] > 0) & (col > edge_px), share.shape))


def test_what_is_dark_by_itself_is_not_taken_for_an_edge() -> None:
    light = np.full((30, 30), 200.0)
    light[10:20, 10:20] = 60.0
    assert not less_than_half_seen(light, np.ones(light.shape, dtype=bool)).any()


def test_nothing_is_said_of_a_thread_of_light_without_whole_pixels_beside_it() -> None:
    lit = np.zeros((30, 30), dtype=bool)
    lit[:, 15] = True
    assert not less_than_half_seen(np.where(lit, 50.0, np.nan), lit).any()


def test_a_photo_in_bands_has_the_same_pixels_half_seen() -> None:
    rng = np.random.default_rng(3)
    row, col = np.mgrid[: BAND_ROWS + 40, :60]
    # A leaning edge, spots of dark, and some light that is not known, on both sides of where two bands meet.
    share = np.clip(20.3 + (row - BAND_ROWS) / 7 - (col - 0.5), 0.0, 1.0)
    share[rng.uniform(size=share.shape) < 0.01] = 0.0
    light = np.where((share > 0) & (rng.uniform(size=share.shape) > 0.02), 200.0 * share, np.nan)
    whole = less_than_half_seen(light, share > 0)
    pixels = np.flatnonzero(np.isfinite(light))
    assert whole[BAND_ROWS - 8 : BAND_ROWS + 8].any()
    np.testing.assert_array_equal(half_seen_of(light.ravel()[pixels], pixels, share > 0), whole)
