"""The intensity curve of a pixel: its model, the running peak, and the two ways to find its centre."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.integrate import quad

from recon.patterns.sweep_frames import stripe_profile
from recon.sessions.manifest import StripePattern
from recon.sweeps.curve_centres import curve_centres
from recon.sweeps.curve_lookup import looked_up
from recon.sweeps.curve_samples import CurveSamples, SweepCurves
from recon.sweeps.curve_table import curve_table
from recon.sweeps.noise import NoiseModel, dark_variance, noise_from_residuals
from recon.sweeps.peak_noise import beside_peak_variance
from recon.sweeps.peak_tracker import PeakTracker
from recon.sweeps.stripe_fit import StripeFit, WidthPrior, fit_stripe
from recon.sweeps.stripe_model import footprint_average
from recon.sweeps.stripe_peak import NO_PEAK, PeakWindows, parabola_offset
from recon.sweeps.stripe_scan import _exponential
from recon.sweeps.width_prior import Footprints, known_prior

COSINE = StripePattern(profile="raised_cosine", width_px=6.0, first_px=0.0, step_px=1.0, count=64)
HARD = StripePattern(profile="hard", width_px=1.0, first_px=0.0, step_px=1.0, count=64)


def averaged_by_quadrature(x: float, a: float, b: float, pattern: StripePattern) -> float:
    """Average the profile over the convolution of two boxes, by nested numerical integration."""

    def over_b(shift: float) -> float:
        def profile(t: float) -> float:
            return float(stripe_profile(np.array([x + shift + t]), pattern)[0])

        edges = [e for e in (pattern.width_px / 2 - x - shift, -pattern.width_px / 2 - x - shift) if abs(e) < b / 2]
        return float(quad(profile, -b / 2, b / 2, points=edges or None, limit=200)[0]) / b

    return float(quad(over_b, -a / 2, a / 2, limit=200)[0]) / a


@pytest.mark.parametrize("pattern", [COSINE, HARD])
@pytest.mark.parametrize(("x", "a", "b"), [(0.0, 0.5, 0.3), (0.7, 0.9, 0.4), (2.9, 1.5, 2.2), (-0.55, 0.2, 0.2)])
def test_the_model_is_the_profile_averaged_over_the_footprint(
    pattern: StripePattern, x: float, a: float, b: float
) -> None:
    value, _ = footprint_average(np.array([[x]]), np.array([a]), np.array([b]), pattern)
    assert value[0, 0] == pytest.approx(averaged_by_quadrature(x, a, b, pattern), abs=2e-5)


@pytest.mark.parametrize("pattern", [COSINE, HARD])
def test_the_slope_is_the_derivative_of_the_model(pattern: StripePattern) -> None:
    x = np.linspace(-5, 5, 101)[None, :]
    a, b, h = np.array([0.8]), np.array([0.3]), 1e-5
    _, slope = footprint_average(x, a, b, pattern)
    above, _ = footprint_average(x + h, a, b, pattern)
    below, _ = footprint_average(x - h, a, b, pattern)
    np.testing.assert_allclose(slope, (above - below) / (2 * h), atol=1e-4)


@settings(max_examples=60, deadline=None)
@given(
    hnp.arrays(np.uint8, st.tuples(st.integers(3, 12), st.just(3), st.just(4)), elements=st.integers(0, 60)),
    st.integers(1, 4),
)
def test_streaming_finds_the_brightest_sample_of_the_whole_stack(stack: np.ndarray, half_width: int) -> None:
    floor = np.full(stack.shape[1:], 20, np.uint8)
    tracker = PeakTracker(floor, half_width=half_width)
    free = np.empty_like(floor)
    for photo in stack:
        # As who decodes into it does: what the tracker gives back is no longer its own.
        np.copyto(free, photo)
        free = tracker.feed(free)
    windows = tracker.finish()
    expected = np.where(stack.max(axis=0) > floor, stack.argmax(axis=0), NO_PEAK).ravel()
    np.testing.assert_array_equal(windows.peak_index, expected)
    columns = stack.reshape(len(stack), -1)
    for pixel, index in enumerate(expected):
        for column in range(-half_width, half_width + 1):
            if index != NO_PEAK and 0 <= index + column < len(stack):
                assert windows.samples[pixel, half_width + column] == columns[index + column, pixel]


def test_the_centre_of_a_curve_is_that_of_the_light_above_a_tenth_of_its_peak_inside_the_sweep() -> None:
    counts = np.array([[10, 14, 50, 90, 50, 30, 10], [10, 10, 10, 90, 50, 10, 10], [10] * 7], np.uint8)
    windows = PeakWindows(np.array([20, 0, 7], np.int32), counts, 3, 64)
    pattern = StripePattern(profile="hard", width_px=1.0, first_px=5.0, step_px=2.0, count=64)
    table = curve_table(pattern, half_width=3, continuous=True)
    sweep = SweepCurves(windows, table, np.full(3, 10, np.uint8), 254)
    centres = curve_centres(sweep, np.array([0, 1]), grid=(1, 3))
    # (−40 + 40 + 2 · 20) / 180 and 40 / 120 of a step; before the first photo of the sweep there is nothing.
    np.testing.assert_allclose(centres, [[5 + 2 * (20 + 40 / 180), 5 + 2 * 40 / 120, np.nan]], rtol=1e-6)


def test_the_exponential_of_the_likelihood_is_off_by_the_remainder_of_its_series_and_rounding() -> None:
    x = np.linspace(-30, 0, 301, dtype=np.float32)
    found = np.array([_exponential(one) for one in x], dtype=np.float64)
    # Taylor's remainder after the fifth power of y = x / 64 relative to exp(y), and a few roundings of it, each 64 times.
    y = -x.astype(np.float64) / 64
    allowed = 64 * (y**6 / 720 * np.exp(y) + 4 * 2.0**-24)
    assert (np.abs(found / np.exp(x.astype(np.float64)) - 1) <= allowed).all()


def test_a_parabola_is_exact_for_a_parabola() -> None:
    centre = np.array([-0.4, 0.0, 0.3])
    samples = [100 - 5 * (k - centre) ** 2 for k in (-1.0, 0.0, 1.0)]
    np.testing.assert_allclose(parabola_offset(*samples), centre, atol=1e-12)


def curves(
    centre: np.ndarray,
    pattern: StripePattern,
    rng: np.random.Generator,
    *,
    footprint_px: tuple[float, float],
    amplitude: float = 200.0,
    black: float = 5.0,
    read_sd: float = 1.0,
    half_width: int = 6,
    off_centre: np.ndarray | float = 0.0,
) -> tuple[PeakWindows, np.ndarray]:
    """Make noisy windows about known centres; the profile's average is taken by brute-force sampling of the footprint."""
    index = np.rint(centre + off_centre).astype(np.int32)
    place = index[:, None] + np.arange(-half_width, half_width + 1)
    u = (np.arange(32) + 0.5) / 32 - 0.5
    spread = (u[:, None] * footprint_px[0] + u[None, :] * footprint_px[1]).ravel()
    signal = np.zeros(place.shape)
    for shift in spread:
        offset = place - centre[:, None] + shift
        signal += stripe_profile(offset.ravel(), pattern).reshape(offset.shape) / len(spread)
    counts = black + amplitude * signal + rng.normal(0.0, read_sd, signal.shape)
    windows = PeakWindows(index, np.clip(np.rint(counts * 16), 0, 65535).astype(np.uint16), half_width, 64)
    return windows, np.full(len(centre), black * 16)


def fitted(
    windows: PeakWindows,
    black: np.ndarray,
    pattern: StripePattern,
    widths: tuple[float, float],
    noise: NoiseModel,
    *,
    clipped: int = 65534,
    continuous: bool = True,
    width_sd: float = 0.02,
) -> StripeFit:
    """Fit with footprints that are known but for their width, known to ``width_sd``."""
    pixels = np.arange(len(windows.peak_index), dtype=np.int64)
    table = curve_table(pattern, half_width=windows.half_width, continuous=continuous)
    prior = known_prior(
        Footprints(np.tile(np.array(widths), (len(pixels), 1)), np.zeros(len(pixels), np.float32), 0.02), sd=width_sd
    )
    return fit_stripe(SweepCurves(windows, table, black, clipped), pixels, prior, noise=noise)


def test_errors_of_the_fit_are_those_it_states() -> None:
    rng = np.random.default_rng(1)
    centre = rng.uniform(20, 40, 4000)
    windows, black = curves(centre, COSINE, rng, footprint_px=(0.7, 0.4))
    fit = fitted(windows, black, COSINE, (0.7, 0.4), NoiseModel(16.0**2))
    normalised = (fit.place_px - centre) / fit.sd_px
    # 4000 samples: the sd of an rms is 1/sqrt(8000), of a mean 1/sqrt(4000); four of them.
    assert 0.955 < np.sqrt((normalised**2).mean()) < 1.045
    assert abs(normalised.mean()) < 4 / np.sqrt(4000)


def test_a_footprint_below_the_thinnest_curve_is_fitted_as_the_thinnest() -> None:
    rng = np.random.default_rng(9)
    windows, black = curves(rng.uniform(20, 40, 200), COSINE, rng, footprint_px=(0.01, 0.01))
    table = curve_table(COSINE, half_width=windows.half_width, continuous=True)
    sweep, pixels = SweepCurves(windows, table, black, 65534), np.arange(200, dtype=np.int64)

    def fit(log_width: float) -> StripeFit:
        prior = WidthPrior(np.zeros(200, dtype=np.int64), np.full(200, log_width), np.full(200, 0.2))
        return fit_stripe(sweep, pixels, prior, noise=NoiseModel(16.0**2))

    below, thinnest = fit(table.log_width[0] - 2.0), fit(table.log_width[0])
    np.testing.assert_allclose(below.place_px, thinnest.place_px, atol=1e-12)
    np.testing.assert_allclose(below.log_width, thinnest.log_width, atol=1e-12)


def test_a_flat_top_is_centred_wherever_on_it_the_brightest_sample_lies() -> None:
    rng = np.random.default_rng(7)
    centre, off_centre = rng.uniform(30, 34, 1000), rng.uniform(-7, 7, 1000)
    windows, black = curves(
        centre, COSINE, rng, footprint_px=(19.0, 0.5), amplitude=600.0, half_width=18, off_centre=off_centre
    )
    fit = fitted(windows, black, COSINE, (19.0, 0.5), NoiseModel(16.0**2))
    assert np.sqrt((((fit.place_px - centre) / fit.sd_px) ** 2).mean()) < 1.1


def test_the_parabola_is_biased_where_the_fit_is_not() -> None:
    rng = np.random.default_rng(2)
    centre = np.full(2000, 30.25)
    windows, black = curves(centre, HARD, rng, footprint_px=(0.9, 0.5))
    fit = fitted(windows, black, HARD, (0.9, 0.5), NoiseModel(16.0**2))
    middle = windows.samples[:, 5:8].astype(np.float64)
    parabola = windows.peak_index + parabola_offset(middle[:, 0], middle[:, 1], middle[:, 2])
    assert abs(parabola.mean() - 30.25) > 0.05
    assert abs(fit.place_px.mean() - 30.25) < 0.005


def test_a_stripe_seen_in_one_photo_alone_is_known_to_an_interval() -> None:
    rng = np.random.default_rng(3)
    centre = rng.uniform(29.9, 30.1, 500)
    windows, black = curves(centre, HARD, rng, footprint_px=(0.2, 0.1), read_sd=0.3)
    fit = fitted(windows, black, HARD, (0.2, 0.1), NoiseModel((0.3 * 16) ** 2))
    # The footprint is 0.3 px from end to end, so the stripe may be centred anywhere within ±0.35 px: sd 0.7/sqrt(12) = 0.20.
    assert np.median(fit.sd_px) == pytest.approx(0.7 / np.sqrt(12), rel=0.15)
    assert np.median(np.abs(fit.place_px - 30.0)) < 0.03


def test_clipped_samples_are_left_out_rather_than_fitted_through() -> None:
    rng = np.random.default_rng(4)
    centre = rng.uniform(20, 40, 1000)
    windows, black = curves(centre, COSINE, rng, footprint_px=(0.7, 0.4))
    ceiling = 150 * 16
    clipped = PeakWindows(windows.peak_index, np.minimum(windows.samples, ceiling), windows.half_width, 64)
    kept_out = fitted(clipped, black, COSINE, (0.7, 0.4), NoiseModel(256.0), clipped=ceiling)
    through = fitted(clipped, black, COSINE, (0.7, 0.4), NoiseModel(256.0))
    error = np.sqrt(((kept_out.place_px - centre) ** 2).mean())
    assert error < 2 * np.median(kept_out.sd_px)
    assert error < np.sqrt(((through.place_px - centre) ** 2).mean())


def test_dark_noise_is_read_from_two_photos_with_the_stripe_elsewhere() -> None:
    rng = np.random.default_rng(5)
    first, second = (np.rint(rng.normal(12, 2.0, (200, 200))).astype(np.uint8) for _ in range(2))
    first[:, :6] = 200
    # Variance of rounded Gaussian noise: 4 + 1/12. 40000 samples: relative sd of a variance 0.7 %.
    assert dark_variance(first, second) == pytest.approx(4 + 1 / 12, rel=0.03)


@pytest.mark.parametrize("ringing_sd", [0.0, 3.0])
def test_noise_beside_a_peak_is_read_from_what_lies_below_black(ringing_sd: float) -> None:
    rng = np.random.default_rng(7)
    counts = rng.normal(40.0, 1.0, (4000, 11))
    counts[:, [4, 6]] += rng.normal(0.0, ringing_sd, (4000, 2))
    counts[:, 5] += 150.0
    # One pixel in four is lit in a second photo as well: that is no noise.
    counts[::4, 6] += 60.0
    windows = PeakWindows(np.full(4000, 20, np.int32), np.rint(counts * 16).astype(np.uint16), 5, 64)
    # 3500 samples below: the sd of a variance is sqrt(2/3500) of it; four of them.
    variance = (1.0 + ringing_sd**2) * 16**2
    assert beside_peak_variance(windows, np.full(4000, 40 * 16)) == pytest.approx(variance, rel=0.1)


def test_a_smooth_stripe_tells_no_noise_beside_its_peak() -> None:
    windows, black = curves(np.linspace(20, 40, 500), COSINE, np.random.default_rng(8), footprint_px=(0.7, 0.4))
    assert beside_peak_variance(windows, black) is None


def test_the_photon_transfer_curve_is_found_from_residuals() -> None:
    rng = np.random.default_rng(6)
    signal = rng.uniform(0.5, 220, 200_000)
    residual = rng.normal(0, np.sqrt(0.4 + 0.05 * signal + (0.01 * signal) ** 2))
    noise = noise_from_residuals(signal, residual, read_variance=0.4, freedom_share=1.0)
    assert noise.variance(np.array([20.0, 100.0, 200.0])) == pytest.approx([1.44, 6.4, 14.4], rel=0.05)


@pytest.mark.parametrize("pattern", [COSINE, HARD])
@pytest.mark.parametrize("centre", [30.0, 30.21, 30.5, 29.62])
def test_on_a_real_display_the_curve_steps_with_the_device_pixels(pattern: StripePattern, centre: float) -> None:
    """Brute force: sample the footprint finely; each sample sees the level of the device pixel that it falls on."""
    widths = (0.8, 0.4)
    u = (np.arange(400) + 0.5) / 400 - 0.5
    seen = np.rint(centre + (u[:, None] * widths[0] + u[None, :] * widths[1]).ravel())
    stripes = np.arange(24.0, 37.0)
    brute = np.array(
        [
            np.clip(1 - np.abs(seen - s), 0, 1).mean()
            if pattern is HARD
            else np.where(np.abs(seen - s) < 3, 0.5 * (1 + np.cos(2 * np.pi * (seen - s) / 6)), 0).mean()
            for s in stripes
        ]
    )
    value, slope = looked_up_curve(pattern, centre, widths)
    np.testing.assert_allclose(value, brute, atol=3e-3)
    above, _ = looked_up_curve(pattern, centre + 0.02, widths)
    below, _ = looked_up_curve(pattern, centre - 0.02, widths)
    # Over ±0.02 px the slope of these curves changes by less than its second derivative, 1 / (0.8 · 0.4), times 0.02.
    np.testing.assert_allclose(slope, (above - below) / 0.04, atol=0.08)


def looked_up_curve(
    pattern: StripePattern, centre: float, widths: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return value and slope of the stepped curve about stripe 30."""
    table = curve_table(pattern, half_width=6, continuous=False)
    prior = known_prior(Footprints(np.array([widths]), np.zeros(1, np.float32), 0.0), sd=0.1)
    samples = CurveSamples(np.zeros((1, 13), np.float32), np.ones((1, 13), bool), np.array([30]), np.array([30.0]))
    value, slope, _ = looked_up(samples, np.array([centre]), prior.log_width, shape=prior.shape, table=table)
    return value[0], slope[0]


def test_a_place_inside_one_device_pixel_is_known_to_that_pixel_and_no_better() -> None:
    rng = np.random.default_rng(7)
    centre = rng.uniform(29.8, 30.2, 300)
    windows, black = curves(np.full(300, 30.0), COSINE, rng, footprint_px=(0.01, 0.01))
    fit = fitted(windows, black, COSINE, (0.2, 0.2), NoiseModel(256.0), continuous=False)
    # A footprint 0.4 px from end to end fits into the pixel at any place within ±0.3 px: sd 0.6/sqrt(12) = 0.17.
    assert np.median(fit.sd_px) == pytest.approx(0.17, abs=0.04)
    assert np.sqrt((((fit.place_px - centre) / fit.sd_px) ** 2).mean()) < 1.2


@pytest.mark.parametrize("continuous", [True, False])
def test_a_place_in_the_middle_of_a_wide_hard_stripe_is_known_to_an_interval(continuous: bool) -> None:
    rng = np.random.default_rng(8)
    windows, black = curves(np.full(300, 30.0), HARD, rng, footprint_px=(0.01, 0.01))
    wide = StripePattern(profile="hard", width_px=5.0, first_px=0.0, step_px=5.0, count=64)
    fit = fitted(windows, black, wide, (2.1, 0.1), NoiseModel(256.0), continuous=continuous)
    # A footprint 2.2 px from end to end fits into the five lit pixels at any place within ±1.4 px: sd 2.8/sqrt(12) = 0.81.
    assert np.median(fit.sd_px) == pytest.approx(2.8 / np.sqrt(12), rel=0.1)
    assert np.median(np.abs(fit.place_px - 150.0)) < 0.1
