"""Places of pixels' centres: bent and unevenly lit footprints, by the shares of light of many points of each pixel.

What a symmetric footprint's likeliest place is is found by least squares, from the same count of points without bend and fading.
"""

import numpy as np
import pytest
from scipy.optimize import least_squares

from recon.patterns.sweep_frames import device_brightness
from recon.sessions.manifest import StripePattern
from recon.sweeps.centre_places import centre_shifts
from recon.sweeps.likelihood import places_by_likelihood
from recon.sweeps.noise import NoiseModel
from recon.sweeps.peak_tracker import PeakTracker

PATTERN = StripePattern(profile="raised_cosine", width_px=6.0, first_px=0.0, step_px=1.0, count=64)
POINTS = 160
STOPS = (np.arange(POINTS) + 0.5) / POINTS - 0.5
ACROSS, DOWN = np.meshgrid(STOPS, STOPS)
SURE_PX = 1e-3
LIGHT = 200.0
EVEN = NoiseModel(read_variance=1.0)
# 20,000 electrons at 255 counts, with a floor of a third of a count.
SHOT = NoiseModel(read_variance=0.1, gain=255 / 20_000)


def shares(place, light):
    """Return the share of a pixel's light that each device pixel gives, for the places and the light of its points."""
    return np.bincount(np.rint(place).astype(int).ravel(), light.ravel(), PATTERN.count) / light.size


def curve(share):
    """Return the brightness of a pixel in all photos of a sweep along which the stripe stands on each device pixel once."""
    number = np.arange(PATTERN.count)
    return device_brightness((number[:, None] - number).astype(float), PATTERN) @ share


def likeliest_shift(place_px, by_col, by_row, bends, fading, noise):
    """Return how far beside its centre's place the likeliest place of an unbent, evenly lit footprint is."""
    bent = 0.5 * bends[0] * ACROSS**2 + bends[1] * ACROSS * DOWN + 0.5 * bends[2] * DOWN**2
    plane = by_col * ACROSS + by_row * DOWN
    seen = curve(shares(place_px + plane + bent, 1 + fading[0] * ACROSS + fading[1] * DOWN))
    # The shares of the likeliest one, smooth enough for least squares: the count of points is not.
    shifts = np.linspace(-0.06, 0.06, 25)
    table = np.array([curve(shares(place_px + shift + plane, np.ones_like(plane))) for shift in shifts])
    fits = [np.polynomial.Polynomial.fit(shifts, column, 3) for column in table.T]

    def left(unknown):
        return (unknown[1] * np.array([one(unknown[0]) for one in fits]) - seen) / sd

    sd = np.sqrt(noise.variance(LIGHT * seen))

    return least_squares(left, [0.0, 1.0]).x[0]


def map_of(middle_px, by_col, by_row, bends, fading):
    """Return place and light of 19 × 19 pixels about one."""
    y, x = (one.astype(float) for one in np.mgrid[-9:10, -9:10])
    place = middle_px + by_col * x + by_row * y + 0.5 * bends[0] * x**2 + bends[1] * x * y + 0.5 * bends[2] * y**2
    return place, (LIGHT * np.exp(fading[0] * x + fading[1] * y)).astype(np.float32)


def shifts_of(place, light, *, trusted=None, noise=EVEN):
    return centre_shifts(
        place,
        np.full(place.shape, SURE_PX, np.float32),
        np.ones(place.shape, dtype=bool) if trusted is None else trusted,
        np.arange(place.size),
        light.ravel(),
        pattern=PATTERN,
        noise=noise,
    )


@pytest.mark.parametrize(
    ("by_col", "by_row", "bends", "fading"),
    [
        (1.3, 0.4, (0.05, 0.0, 0.0), (0.0, 0.0)),
        (-1.3, 0.4, (0.05, 0.03, -0.02), (0.0, 0.0)),
        (0.5, -2.2, (0.0, 0.04, 0.06), (0.0, 0.0)),
        (0.3, 1.6, (0.0, 0.0, 0.0), (0.02, 0.05)),
        (-2.1, -0.7, (-0.05, 0.02, 0.03), (0.04, -0.03)),
        (3.6, 0.2, (0.06, 0.0, 0.02), (0.03, 0.0)),
    ],
)
@pytest.mark.parametrize("middle_px", [31.6, 31.9, 32.25])
@pytest.mark.parametrize("noise", [EVEN, SHOT])
def test_a_bent_or_fading_footprint_is_moved_to_its_centre(by_col, by_row, bends, fading, middle_px, noise):
    place, light = map_of(middle_px, by_col, by_row, bends, fading)
    found, doubt = shifts_of(place, light, noise=noise)
    expected = likeliest_shift(middle_px, by_col, by_row, bends, fading, noise)
    assert doubt[9, 9] == 0
    # Lines and points are counted, and what is of second order is left out.
    assert found[9, 9] == pytest.approx(expected, abs=3e-4 + 0.15 * abs(expected))


def test_dim_samples_say_most_of_a_steep_footprint_in_shot_noise():
    steep = (4.0, 1.6, (0.3, 0.0, 0.0), (-0.06, 0.0))
    place, light = map_of(31.9, *steep)
    by_noise = [
        (shifts_of(place, light, noise=one)[0][9, 9], likeliest_shift(31.9, *steep, one)) for one in (EVEN, SHOT)
    ]
    (even, expected_even), (shot, expected_shot) = by_noise
    assert shot - even == pytest.approx(expected_shot - expected_even, rel=0.25)
    assert expected_shot - expected_even > 0.001


@pytest.mark.parametrize("slope", [30.0, 60.0, 120.0])
def test_a_fading_footprint_wider_than_the_stripe_is_moved_by_its_two_ends(slope):
    """A box that fades by a share a, seen as if it did not: of its ends ±½ of the step is missing, rising by 1 over its width.

    With P = ∫ p and the correlation R of the stripe's profile p with itself, least squares move the box by
    a (P²/2 − 2 ∫₀^∞ t R dt / slope) / (2 R(0)).
    """
    width, fading = 24.0, 0.05
    wide = StripePattern(profile="raised_cosine", width_px=width, first_px=0.0, step_px=1.0, count=4000)
    at = np.linspace(-width, width, 4801)
    spacing = at[1] - at[0]
    profile = np.where(np.abs(at) < width / 2, 0.5 * (1 + np.cos(2 * np.pi * at / width)), 0.0)
    alike = np.correlate(profile, profile, "full")[len(at) - 1 :] * spacing
    first_moment = (alike * spacing * np.arange(len(alike))).sum() * spacing
    whole = profile.sum() * spacing
    expected = fading * (whole**2 / 2 - 2 * first_moment / slope) / (2 * alike[0])
    place, light = map_of(2000.2, slope, 0.0, (0.0, 0.0, 0.0), (fading, 0.0))
    found, _ = centre_shifts(
        place,
        np.full(place.shape, SURE_PX, np.float32),
        np.ones(place.shape, dtype=bool),
        np.arange(place.size),
        light.ravel(),
        pattern=wide,
        noise=EVEN,
    )
    assert found[9, 9] == pytest.approx(expected, rel=0.03)


def test_a_footprint_within_one_device_pixel_is_not_moved():
    place, light = map_of(32.0, 0.4, 0.1, (0.01, 0.0, 0.0), (0.02, 0.0))
    found, _ = shifts_of(place, light)
    assert found[9, 9] == 0


def test_a_crease_bends_no_footprint():
    y, x = np.mgrid[:40, :50]
    place = 30 + 0.9 * x + 0.2 * y + np.where(x > 24, 0.8 * (x - 24), 0.0)
    found, _ = shifts_of(place, np.full(place.shape, 200, np.float32))
    assert np.abs(found).max() < 1e-4


def test_the_edge_takes_what_its_neighbours_are_moved_by_and_the_untrusted_stay():
    y, x = (one.astype(float) for one in np.mgrid[:30, :30])
    place = 10 + 1.5 * x + 0.02 * x**2 + 0.1 * y
    trusted = np.ones(place.shape, dtype=bool)
    trusted[:, 24:] = False
    found, doubt = shifts_of(place, np.full(place.shape, 200, np.float32), trusted=trusted)
    assert found[15, 23] == pytest.approx(0.04 / 24, rel=0.5)
    assert not found[:, 24:].any()
    # Its light does not fade; twice what the bend C = 0.04 may move it, C/24, is doubted on top of what it is moved by.
    assert doubt[15, 23] == pytest.approx(np.hypot(found[15, 23], 0.04 / 12), rel=0.01)
    assert not doubt[3:-3, 3:20].any()
    assert not doubt[:, 24:].any()


def test_an_edge_towards_which_light_fades_is_as_unsure_as_bend_and_fading_each():
    y, x = (one.astype(float) for one in np.mgrid[:30, :30])
    place = 10 + 1.5 * x + 0.02 * x**2 + 0.1 * y
    trusted = np.ones(place.shape, dtype=bool)
    trusted[:, 24:] = False
    # Fading that takes away what the bend moves.
    light = (200 * np.exp(-0.0085 * x)).astype(np.float32)
    found, doubt = shifts_of(place, light, trusted=trusted)
    step = place[15, 23] - place[15, 22]
    assert abs(found[15, 23]) < 0.001
    assert doubt[15, 23] == pytest.approx((0.04 + step * 0.0085) / 12, rel=0.05)


def test_what_lies_beyond_a_jump_makes_no_place_unsure():
    y, x = np.mgrid[:40, :50]
    place = 30 + 0.9 * x + 0.2 * y + np.where(x > 24, 18.0, 0.0)
    light = np.where(x > 24, 250, 200).astype(np.float32)
    _, doubt = shifts_of(place, light)
    assert doubt.max() < 1e-3


def test_beyond_a_small_jump_a_place_may_be_a_share_of_it_off():
    y, x = np.mgrid[:40, :50]
    place = 30 + 0.4 * x + 0.1 * y + np.where(x > 24, 1.2, 0.0)
    # A strip that holds no window of its own is told from this side.
    _, doubt = shifts_of(place, np.full(place.shape, 200, np.float32), trusted=x < 27)
    # The jump anywhere between the middles of two pixels: its share of either is what lies beyond the border, ½ at most.
    beyond = np.linspace(0, 1, 10001)
    share = np.maximum(0.5 - beyond, 0.0)
    assert doubt[20, 25] == pytest.approx(1.2 * np.sqrt((share**2).mean()), rel=0.05)
    assert not doubt[4:-4, 3:20].any()


def test_decoded_places_are_those_of_centres():
    rng = np.random.default_rng(5)
    row, col = (one.astype(float) for one in np.mgrid[:24, :24])
    bend = 0.08
    centre = 6.3 + 1.1 * col + 0.5 * bend * col**2 + 0.13 * row
    slope = 1.1 + bend * col
    kept = centre < PATTERN.count - 8
    share = np.stack(
        [
            shares(place + steep * ACROSS + 0.5 * bend * ACROSS**2 + 0.13 * DOWN, np.ones_like(ACROSS))
            for place, steep in zip(centre[kept], slope[kept], strict=True)
        ]
    )
    height = np.zeros((PATTERN.count, *centre.shape))
    height[:, kept] = np.array([curve(one) for one in share]).T
    black = np.full(centre.shape, 500, np.uint16)
    tracker = PeakTracker(np.full(centre.shape, 600, np.uint16), half_width=8)
    for one in height:
        tracker.feed(np.rint(500 + 40_000 * one + rng.normal(0, 20, centre.shape)).astype(np.uint16))
    found = places_by_likelihood(
        tracker.finish(),
        np.flatnonzero(kept),
        PATTERN,
        black=black,
        dark_variance=400.0,
        clipped=65_535,
        continuous=False,
    ).place_px
    inner = kept & (col > 4) & (centre < PATTERN.count - 16) & np.isfinite(found)
    assert inner.sum() > 200
    error = (found - centre)[inner]
    # The mean of a footprint is bend / 24 = 0.0033 px beside its centre.
    assert abs(error.mean()) < 0.0008
