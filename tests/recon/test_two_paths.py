"""A pixel that sees the display by two light paths: both are found, neither is averaged, and one path is never taken for two."""

import numpy as np
import pytest

from recon.sessions.manifest import StripePattern
from recon.study.stripe_bound import blurred_profile
from recon.sweeps.curve_samples import SweepCurves
from recon.sweeps.curve_table import curve_table
from recon.sweeps.noise import NoiseModel
from recon.sweeps.peak_tracker import PeakTracker
from recon.sweeps.stripe_fit import WidthPrior, fit_stripe
from recon.sweeps.two_paths import TwoPaths, two_paths, unresolved_px
from recon.sweeps.width_prior import Footprints, known_prior

STRIPES = {
    "raised_cosine": StripePattern(profile="raised_cosine", width_px=6.0, first_px=0.0, step_px=1.0, count=64),
    "hard": StripePattern(profile="hard", width_px=1.0, first_px=0.0, step_px=1.0, count=64),
}
BLACK, NOISE_SD = 1000, 16.0
PIXELS = 2000
FOOTPRINT_PX = 0.8
Path = tuple[np.ndarray, float, float]  # places, height of the peak in counts, sd of the Gaussian footprint


def swept(paths: list[Path], pattern: StripePattern, *, seed: int, pixels: int = PIXELS) -> SweepCurves:
    """Return what a sweep shows of pixels whose curve is the sum of known ones: Gaussian footprints, Gaussian noise."""
    rng = np.random.default_rng(seed)
    grid = np.linspace(-pattern.count, pattern.count, 20_001)
    profiles = [blurred_profile(grid, footprint_px, pattern) for _, _, footprint_px in paths]
    tracker = PeakTracker(np.full((1, pixels), BLACK + int(6 * NOISE_SD), np.uint16), half_width=7)
    for number in range(pattern.count):
        counts = BLACK + rng.normal(0.0, NOISE_SD, pixels)
        for (place_px, height, _), profile in zip(paths, profiles, strict=True):
            counts += height * np.interp(place_px - number, grid, profile / profile.max())
        tracker.feed(np.rint(counts).astype(np.uint16)[None])
    table = curve_table(pattern, half_width=7, continuous=True)
    return SweepCurves(tracker.finish(), table, np.full(pixels, BLACK), 65_535)


def prior_of(curves: SweepCurves) -> WidthPrior:
    """Return what neighbours would say of a Gaussian footprint."""
    return known_prior(
        Footprints(np.zeros((len(curves.black), 2)), np.zeros(len(curves.black), np.float32), FOOTPRINT_PX), sd=0.15
    )


def found(curves: SweepCurves) -> TwoPaths:
    return two_paths(curves, np.arange(len(curves.black)), prior_of(curves), noise=NoiseModel(NOISE_SD**2))


@pytest.mark.parametrize("profile", list(STRIPES))
def test_both_places_err_as_they_say_where_a_curve_is_the_sum_of_two(profile: str) -> None:
    rng = np.random.default_rng(1)
    near, far = rng.uniform(20, 30, PIXELS), rng.uniform(40, 50, PIXELS)
    two = found(swept([(near, 6000.0, FOOTPRINT_PX), (far, 2500.0, 1.2)], STRIPES[profile], seed=2))
    assert len(two.rows) == PIXELS
    for fit, truth in ((two.first, near), (two.second, far)):
        normalised = (fit.place_px - truth) / fit.sd_px
        # 2000 pixels: the sd of an rms is 1/sqrt(4000), of a mean 1/sqrt(2000); four of them.
        assert np.sqrt((normalised**2).mean()) == pytest.approx(1.0, abs=0.063)
        assert abs(normalised.mean()) < 4 / np.sqrt(PIXELS)


def test_the_path_with_more_light_comes_first_though_the_other_has_the_brighter_sample() -> None:
    # Under a stripe of one pixel a peak of height 2500 and sd 3 px holds more light than one of height 4000 and 0.8 px.
    sharp, broad = np.full(PIXELS, 15.0), np.full(PIXELS, 45.0)
    two = found(swept([(sharp, 4000.0, FOOTPRINT_PX), (broad, 2500.0, 3.0)], STRIPES["hard"], seed=3))
    assert len(two.rows) == PIXELS
    np.testing.assert_allclose(two.first.place_px, broad, atol=0.5)


@pytest.mark.parametrize("profile", list(STRIPES))
def test_a_pixel_with_one_path_is_never_taken_for_one_with_two(profile: str) -> None:
    # 20,000 pixels in 64 photos: a million chances of one in a thousand million each.
    pixels = 20_000
    place_px = np.random.default_rng(4).uniform(20, 40, pixels)
    curves = swept([(place_px, 3000.0, FOOTPRINT_PX)], STRIPES[profile], seed=5, pixels=pixels)
    assert len(found(curves).rows) == 0


def test_two_paths_too_close_to_be_told_apart_are_known_to_their_distance() -> None:
    near = np.random.default_rng(6).uniform(29, 31, PIXELS)
    both = [(near, 3000.0, FOOTPRINT_PX), (near + 4, 3000.0, FOOTPRINT_PX)]
    curves = swept(both, STRIPES["raised_cosine"], seed=7)
    assert len(found(curves).rows) == 0
    prior = prior_of(curves)
    fit = fit_stripe(curves, np.arange(PIXELS), prior, noise=NoiseModel(NOISE_SD**2))
    # Half the light each, 4 px apart: the mean lies 2 px from either.
    np.testing.assert_allclose(fit.place_px - near, 2.0, atol=0.1)
    assert (unresolved_px(fit, prior) > 2.0).all()
    assert (unresolved_px(fit, prior) < 3.0).mean() > 0.99
    alone = swept([(near, 3000.0, FOOTPRINT_PX)], STRIPES["raised_cosine"], seed=8)
    assert (unresolved_px(fit_stripe(alone, np.arange(PIXELS), prior, noise=NoiseModel(NOISE_SD**2)), prior) == 0).all()


@pytest.mark.parametrize("curve", [[0, 9, 50, 9, 0, 0, 0, 30, 90, 30, 0], [0, 30, 90, 30, 0, 0, 0, 9, 50, 9, 0]])
def test_the_second_peak_is_kept_whichever_comes_first(curve: list[int]) -> None:
    tracker = PeakTracker(np.full((1, 1), 10, np.uint8), half_width=2)
    for sample in curve:
        tracker.feed(np.full((1, 1), sample, np.uint8))
    first = tracker.finish()
    assert first.second is not None
    second = first.second.windows
    assert first.second.rows_of(np.arange(1)).tolist() == [0]
    assert first.samples[0].tolist() == [0, 30, 90, 30, 0]
    assert second.samples[0].tolist() == [0, 9, 50, 9, 0]
    assert {int(first.peak_index[0]), int(second.peak_index[0])} == {2, 8}
