"""What is known of a footprint's width before its curve is fitted: by its boxes, the common blur, and its neighbours' curves."""

from dataclasses import replace

import numpy as np
import pytest

from recon.sweeps.stripe_fit import StripeFit
from recon.sweeps.width_prior import BLUR_SD, EVEN_SD, GRADIENT_SD, Footprints, known_prior, neighbour_widths

COLUMNS = 30
PIXELS = np.arange(COLUMNS * COLUMNS)


def footprints(*, box_sd: float, blur_px: float = 0.0) -> Footprints:
    count = len(PIXELS)
    return Footprints(np.tile([0.5, 0.1], (count, 1)), np.full(count, box_sd, np.float32), blur_px)


def fits(log_width: np.ndarray, information: float) -> StripeFit:
    ones = np.ones(len(PIXELS))
    return StripeFit(ones, ones, ones, ones, log_width, information * ones, ones, ones)


def test_a_blur_counts_by_its_share_of_the_variance() -> None:
    assert known_prior(footprints(box_sd=EVEN_SD)).sd == pytest.approx(EVEN_SD)
    # Of d log w = (d box² + d blur²) / 2 w² each part moves its own share.
    half = known_prior(footprints(box_sd=EVEN_SD, blur_px=np.sqrt((0.5**2 + 0.1**2) / 12))).sd
    assert half == pytest.approx(np.hypot(EVEN_SD, BLUR_SD) / 2)


@pytest.mark.parametrize("box_sd", [EVEN_SD, GRADIENT_SD])
def test_without_curves_that_tell_their_width_only_the_boxes_do(box_sd: float) -> None:
    prints = footprints(box_sd=box_sd)
    silent = fits(prints.predicted()[0] + 0.5, 1e-12)
    prior = neighbour_widths(silent, prints, PIXELS, grid=(COLUMNS, COLUMNS), spacing=1).prior(prints, PIXELS)
    np.testing.assert_allclose(prior.log_width, prints.predicted()[0], atol=1e-4)
    np.testing.assert_allclose(prior.sd, np.hypot(2 / 3, 1) * box_sd, rtol=1e-3)


def test_curves_that_tell_their_width_overrule_the_boxes_and_scatter_of_these_makes_unsure() -> None:
    prints = footprints(box_sd=EVEN_SD)
    wider = 0.3
    told = fits(prints.predicted()[0] + wider, 1e6)
    alike = neighbour_widths(told, prints, PIXELS, grid=(COLUMNS, COLUMNS), spacing=1).prior(prints, PIXELS)
    middle = COLUMNS // 2 * COLUMNS + COLUMNS // 2
    assert alike.log_width[middle] - prints.predicted()[0][middle] == pytest.approx(wider, rel=0.02)
    signs = np.where((PIXELS // COLUMNS + PIXELS) % 2, 1.0, -1.0)  # as on a chessboard
    scattered = replace(told, log_width=told.log_width + 0.2 * signs)
    apart = neighbour_widths(scattered, prints, PIXELS, grid=(COLUMNS, COLUMNS), spacing=1).prior(prints, PIXELS)
    assert apart.sd[middle] == pytest.approx(np.hypot(alike.sd[middle], 0.2), rel=0.02)
