"""Standard deviations of places whose curves are not quite the model's."""

import numpy as np
import pytest
from scipy.stats import chi2

from recon.sweeps.misfit import BAND_ROWS, OWN_MISFIT_CHANCE, SCALE_WINDOW_PX, widen_by_misfit

SHAPE = (2 * BAND_ROWS + 30, 90)


def widened(ratio: np.ndarray, known: np.ndarray, *, freedom: float) -> np.ndarray:
    """Return sds of 1 px, widened by these ratios [rows, cols]; pixels that are not known have no sd, but a fit."""
    sd = np.where(known, np.float32(1), np.float32(np.nan))
    pixels = np.arange(sd.size, dtype=np.int32)
    widen_by_misfit(sd, ratio.ravel().astype(np.float32), np.full(sd.size, freedom, np.float32), pixels)
    return sd


@pytest.mark.parametrize(("ratio", "times"), [(0.3, 1.0), (1.0, 1.0), (2.25, 1.5)])
def test_sds_grow_by_the_root_of_the_ratio_that_all_have_and_never_shrink(ratio: float, times: float) -> None:
    sd = widened(np.full(SHAPE, ratio), np.ones(SHAPE, dtype=bool), freedom=10.0)
    np.testing.assert_allclose(sd, times, rtol=1e-6)


def test_the_mean_over_the_known_pixels_of_the_window_counts() -> None:
    rng = np.random.default_rng(4)
    ratio, known = rng.uniform(0.8, 1.6, SHAPE), rng.random(SHAPE) < 0.4
    sd = widened(ratio, known, freedom=10.0)
    half = SCALE_WINDOW_PX // 2
    for row, col in np.argwhere(known)[::37]:
        window = np.s_[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
        mean = ratio[window][known[window]].mean()
        assert sd[row, col] == pytest.approx(np.sqrt(max(mean, 1.0)), rel=1e-5)
    assert np.isnan(sd[~known]).all()


@pytest.mark.parametrize(("share_of_limit", "counts"), [(0.98, False), (1.02, True)])
def test_a_pixels_own_ratio_counts_where_chance_does_not_explain_it(share_of_limit: float, counts: bool) -> None:
    freedom, others = 8.0, 1.5
    row, col = BAND_ROWS, 40
    # In its own window the pixel counts as no more than 4.
    mean = (others * (SCALE_WINDOW_PX**2 - 1) + 4.0) / SCALE_WINDOW_PX**2
    own = share_of_limit * mean * chi2.isf(OWN_MISFIT_CHANCE, freedom) / freedom
    assert own > 4.0
    ratio = np.full(SHAPE, others)
    ratio[row, col] = own
    sd = widened(ratio, np.ones(SHAPE, dtype=bool), freedom=freedom)
    assert sd[row, col] ** 2 == pytest.approx(own if counts else mean, rel=1e-5)
    assert sd[row, col + 1] ** 2 == pytest.approx(mean, rel=1e-5)
