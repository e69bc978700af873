"""The bound of a stripe's place against closed forms, and the decoder's places against the bound."""

import numpy as np
import pytest
from scipy.special import ndtr

from recon.sessions.pattern import StripePattern
from recon.study.correspondence_study import decoded, sample_noise, stripe_patterns
from recon.study.stripe_bound import SampleNoise, blurred_profile, place_bound_px
from recon.sweeps.curve_reach import curve_half_width
from recon.sweeps.map_scatter import scatter_beyond

HARD, COSINE = stripe_patterns().values()


def test_a_hard_stripe_through_a_gaussian_is_a_difference_of_normal_distributions() -> None:
    x = np.linspace(-4, 4, 81)
    np.testing.assert_allclose(blurred_profile(x, 0.7, HARD), ndtr((x + 0.5) / 0.7) - ndtr((x - 0.5) / 0.7), atol=1e-9)


@pytest.mark.parametrize("pattern", [HARD, COSINE])
def test_the_bound_of_a_wide_footprint_is_that_of_a_gaussian_curve(pattern: StripePattern) -> None:
    """For a Gaussian of sd s sampled at unit steps Σ m'² = √π / 2s, so that the bound is √(2s/√π) σ/A; known: Kay 1993, ch. 3."""
    # A stripe adds its own variance: 1/12 for a box of one step, (1/12 − 1/2π²) of its width squared for a raised cosine.
    own = 1 / 12 if pattern is HARD else 36 * (1 / 12 - 1 / (2 * np.pi**2))
    bound = place_bound_px(4.0, pattern, noise=SampleNoise(1e-4), width_known=True)
    assert bound == pytest.approx(np.sqrt(2 * np.sqrt(16 + own) / np.sqrt(np.pi)) / 100, rel=0.005)


@pytest.mark.parametrize(
    ("label", "footprint_px", "kind"), [("hard 1", 1.0, "read"), ("raised cosine 6", 0.6, "photon")]
)
def test_places_are_as_good_as_the_photos_allow_and_their_sds_are_true(
    label: str, footprint_px: float, kind: str
) -> None:
    pattern, noise = stripe_patterns()[label], sample_noise(kind, 100.0)
    seen = decoded(pattern, footprint_px, noise, columns=64, rng=np.random.default_rng(3))
    bound = place_bound_px(footprint_px, pattern, noise=noise, width_known=False)
    ratio = seen.error_px / seen.sd_px
    assert len(ratio) == 64**2
    assert seen.rms_px() <= 1.1 * bound
    # 4,096 pixels: a mean is known to a sixty-fourth of the bound. Four of these are below a tenth of it.
    assert abs(seen.error_px.mean()) < 0.1 * bound
    # The sd of an rms is 1/√8192; four of them, and two percent for what the decoder must estimate.
    assert np.sqrt((ratio**2).mean()) == pytest.approx(1.0, abs=4 / np.sqrt(2 * 64**2) + 0.02)
    assert 0.93 <= (np.abs(ratio) <= 1.96).mean() <= 0.97


@pytest.mark.parametrize(("footprint_px", "expected"), [(0.3, 4), (2.0, 8), (3.6, 12)])
def test_windows_reach_as_far_as_the_curves(footprint_px: float, expected: int) -> None:
    """Where the curve falls below a twentieth: at √(2 ln 20) = 2.45 sd."""
    seen = np.linspace(10, 50, 80 * 80).reshape(80, 80)

    def photo(number: int) -> np.ndarray:
        height = blurred_profile((seen - number).ravel(), footprint_px, HARD)
        return (
            np.rint(100 + 5000 * height / blurred_profile(np.zeros(1), footprint_px, HARD))
            .reshape(seen.shape)
            .astype(np.uint16)
        )

    black = np.full(seen.shape, 100, np.uint16)
    found = curve_half_width(photo, range(60), black=black, floor=(black + 10).astype(np.uint16), least=4)
    assert found == expected


@pytest.mark.parametrize("jump_px", [0.0, 5.0])
def test_scatter_that_no_sd_tells_is_found_in_a_bent_map_with_a_jump_and_a_gap(jump_px: float) -> None:
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:120, :120] / 10.0
    sd = np.full(x.shape, 0.01)
    footprint_px = 0.2 + 0.02 * x
    place = 40 + 6 * np.sin(0.1 * x) + 0.3 * y**2 + rng.normal(0, np.hypot(0.01, 0.1 * footprint_px), x.shape)
    place[x + y > 12] += jump_px
    place[30:50, 30:50] = np.nan
    # Some 2,500 places: their variance is known to a thirtieth, the scatter to a sixtieth; four of them.
    assert scatter_beyond(place, sd, footprint_px) == pytest.approx(0.1, rel=0.067)
    assert scatter_beyond(place, np.full(x.shape, 0.06), footprint_px) == 0.0
