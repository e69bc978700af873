"""Shifts of a texture whose shift is known in closed form: found without bias, and with the scatter that noise allows."""

import numpy as np
import pytest

from recon.patterns.reference_frame import reference_levels
from recon.scene.photo_noise import PhotoNoise
from recon.scene.scene_shift import noise_of_pair, part_shift

SIDE = 160
SD = 2.0
WHITE = PhotoNoise(floor=SD**2, slope=0.0)
EVERYWHERE = np.ones((SIDE, SIDE), bool)
ROW, COLUMN = np.mgrid[0:SIDE, 0:SIDE].astype(np.float64)
WAVES = [
    (2 * np.pi / period, turn, phase)
    for period, turn, phase in np.random.default_rng(3).uniform((6, 0, 0), (48, 2 * np.pi, 2 * np.pi), (60, 3))
]
AMPLITUDE = 40 / np.sqrt(len(WAVES) / 2)


def texture(dx: np.ndarray | float = 0.0, dy: np.ndarray | float = 0.0) -> np.ndarray:
    """Sixty plane waves of 6 to 48 px, moved by (dx, dy)."""
    total = np.full((SIDE, SIDE), 120.0)
    for k, turn, phase in WAVES:
        total += AMPLITUDE * np.cos(k * (np.cos(turn) * (COLUMN - dx) + np.sin(turn) * (ROW - dy)) + phase)
    return total


def slopes() -> tuple[np.ndarray, np.ndarray]:
    along, down = np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE))
    for k, turn, phase in WAVES:
        sine = np.sin(k * (np.cos(turn) * COLUMN + np.sin(turn) * ROW) + phase)
        along -= AMPLITUDE * k * np.cos(turn) * sine
        down -= AMPLITUDE * k * np.sin(turn) * sine
    return along, down


def photo(picture: np.ndarray, rng: np.random.Generator | None = None) -> np.ndarray:
    noise = rng.normal(0, SD, picture.shape) if rng else 0.0
    return (picture + noise).astype(np.float32)


@pytest.mark.parametrize("shift", [(0.02, -0.01), (0.3, 0.1), (0.8, -0.5), (2.6, 1.2), (7.3, -3.2)])
def test_a_shift_is_found_without_noise_to_a_hundredth_of_itself(shift: tuple[float, float]) -> None:
    found = part_shift(photo(texture()), photo(texture(*shift)), EVERYWHERE, WHITE)
    assert found is not None
    # Third order of the straight line: (k d)² / 24, with k up to 1.05 and a rest of up to 0.6 px after whole pixels.
    rest = np.array(shift) - np.rint(shift)
    np.testing.assert_allclose(found.shift_px, shift, atol=0.017 * max(np.abs(rest)))
    assert found.spread_px < 0.02


def test_shifts_scatter_as_little_as_the_bound_allows_and_as_their_sd_says() -> None:
    rng, shift, rounds = np.random.default_rng(11), np.array([0.05, -0.02]), 60
    found = [part_shift(photo(texture(), rng), photo(texture(*shift), rng), EVERYWHERE, WHITE) for _ in range(rounds)]
    shifts = np.array([one.shift_px for one in found if one])
    assert len(shifts) == rounds
    # Cramér-Rao: two photos of noise SD, the gradient known.
    along, down = slopes()
    fisher = np.array([[(along * along).sum(), (along * down).sum()], [(along * down).sum(), (down * down).sum()]]) / (
        2 * SD**2
    )
    bound = np.sqrt(np.diag(np.linalg.inv(fisher)))
    scatter = shifts.std(axis=0, ddof=1)
    # A standard deviation from N rounds is good to 1 / √(2 N), 9 %; four times that, and a tenth for what blocks and edges lose.
    assert (scatter < bound * (1.1 + 4 / np.sqrt(2 * rounds))).all()
    said = np.mean([one.sd_px for one in found if one], axis=0)
    np.testing.assert_allclose(said / scatter, 1.0, atol=0.15 + 4 / np.sqrt(2 * rounds))
    np.testing.assert_allclose(shifts.mean(axis=0), shift, atol=4 * bound.max() / np.sqrt(rounds))


def test_a_change_of_light_is_told_from_a_shift() -> None:
    rng = np.random.default_rng(5)
    found = part_shift(photo(texture(), rng), photo(0.95 * texture(0.1, 0.0), rng), EVERYWHERE, WHITE)
    assert found is not None
    # The gain is relative to the mean of both photos: (0.95 − 1) / 0.975.
    assert found.light == pytest.approx(-0.05 / 0.975, abs=5 * found.light_sd)
    assert found.shift_px == pytest.approx((0.1, 0.0), abs=5 * max(found.sd_px))


def test_blocks_that_move_differently_are_noticed() -> None:
    rng = np.random.default_rng(6)
    bowl = 0.2 * np.sin(2 * np.pi * COLUMN / SIDE)
    found = part_shift(photo(texture(), rng), photo(texture(bowl), rng), EVERYWHERE, WHITE)
    assert found is not None
    assert found.spread_sigma > 20
    # rms of a sine
    assert found.spread_px == pytest.approx(0.2 / np.sqrt(2), rel=0.15)
    still = part_shift(photo(texture(), rng), photo(texture(0.1, 0.1), rng), EVERYWHERE, WHITE)
    assert still is not None
    assert still.spread_sigma < 4


def test_only_what_is_under_the_mask_counts() -> None:
    rng = np.random.default_rng(7)
    half = COLUMN < SIDE / 2
    second = np.where(half, texture(0.3, 0.0), texture(-0.2, 0.0))
    left, right = (part_shift(photo(texture(), rng), photo(second, rng), mask, WHITE) for mask in (half, ~half))
    assert left is not None
    assert right is not None
    assert left.shift_px == pytest.approx((0.3, 0.0), abs=5 * max(left.sd_px))
    assert right.shift_px == pytest.approx((-0.2, 0.0), abs=5 * max(right.sd_px))


def test_a_picture_without_texture_says_nothing() -> None:
    flat = np.full((SIDE, SIDE), 90.0, np.float32)
    assert part_shift(flat, flat, EVERYWHERE, WHITE) is None
    assert part_shift(photo(texture()), photo(texture()), ~EVERYWHERE, WHITE) is None


def test_the_noise_of_a_quiet_pair_is_the_noise_that_was_put_in() -> None:
    rng = np.random.default_rng(8)
    picture = texture()

    def shot() -> np.ndarray:
        return (picture + rng.normal(0, 1, picture.shape) * np.sqrt(1.5 + 0.02 * picture)).astype(np.float32)

    noise = noise_of_pair(shot(), shot(), EVERYWHERE)
    level = np.array([[60.0, 120.0, 180.0]], np.float32)
    # A variance from N pixels is good to √(2 / N); a tenth of the pixels each: 3 %. The cut at three sd takes another 3 %.
    np.testing.assert_allclose(noise.variance(level), 2 * (1.5 + 0.02 * level), rtol=0.12)
    assert 0.6 < noise.inflation < 1.2


def test_the_reference_frame_holds_only_the_periods_that_were_asked_for() -> None:
    levels = reference_levels(columns=256, rows=192, finest_px=8.0).astype(np.float64)
    power = np.abs(np.fft.fft2(levels - levels.mean())) ** 2
    frequency = np.hypot(np.fft.fftfreq(192)[:, None], np.fft.fftfreq(256)[None, :])
    inside = (frequency <= 1 / 8) & (frequency >= 1 / 64)
    # What is outside comes from rounding and from the few levels cut off at black and white.
    assert power[inside].sum() > 0.98 * power.sum()
    assert 100 < levels.mean() < 156
    assert levels.std() > 40
