"""Lines and Gray code: what the display shows, and places read back from curves that quadrature makes."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.special import erf

from recon.errors import SessionError
from recon.metrics import PhotoQuality
from recon.patterns.gray_line import gray_line_levels
from recon.patterns.sweep_frames import stripe_frame
from recon.patterns.swept_range import narrowed
from recon.sessions.importer import import_folder, read_layout
from recon.sessions.journal import SweepRange
from recon.sessions.pattern import GrayLinePattern
from recon.sessions.session import open_session
from recon.sessions.wholeness import faults
from recon.status import PixelStatus
from recon.sweeps.correspondence import place_by_likelihood
from recon.sweeps.gray_line import line_samples, line_windows, read_bars
from recon.sweeps.stripe_peak import NO_PEAK

DEVICE_PX = 256
WHITE, BLACK = 200.0, 5.0
STRIP = PhotoQuality(set="pos0_air", sweep="x", index=0, brightest=200.0, saturated_share=0.0)


def pattern(**changes: object) -> GrayLinePattern:
    fields = {"profile": "raised_cosine", "width_px": 4.0, "first_px": 0.0, "step_px": 1.0, "period_px": 16.0}
    return GrayLinePattern.model_validate({"kind": "gray_line", **fields, "places": DEVICE_PX, **changes})


def photos(
    place_px: np.ndarray, one: GrayLinePattern, *, footprint_px: float, noise: float, seed: int = 1
) -> Iterator[np.ndarray]:
    """Yield what pixels with a Gaussian footprint about ``place_px`` see: device pixels weighted by the normal integral."""
    edges = np.arange(DEVICE_PX + 1) - 0.5
    below = 0.5 * (1 + erf((edges - place_px.reshape(-1, 1)) / (np.sqrt(2) * footprint_px)))
    share = np.diff(below, axis=1)
    rng = np.random.default_rng(seed)
    for index in range(one.count):
        light = share @ gray_line_levels(one, index, device_px=DEVICE_PX) / 255.0
        counts = BLACK + (WHITE - BLACK) * light + noise * rng.standard_normal(light.shape)
        yield np.round(np.clip(counts, 0, 255)).astype(np.uint8).reshape(place_px.shape)


def decoded(
    place_px: np.ndarray, one: GrayLinePattern, seen: Iterator[np.ndarray], *, noise: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return places, their sd and status as a sweep's decoding does."""
    black = np.full(place_px.shape, round(BLACK), dtype=np.uint8)
    lines = line_samples((next(seen) for _ in range(one.steps)), one)
    bars = read_bars(seen, one, pixels=place_px.size, dark_variance=noise**2 + 1 / 12)
    windows, doubtful = line_windows(lines, bars, one, black=black.ravel(), dark_variance=noise**2 + 1 / 12)
    result = place_by_likelihood(
        windows, one.as_sweep(), black=black, dark=noise**2 + 1 / 12, clipped=254, photos=(STRIP,), continuous=False
    )
    status = result.status.copy()
    status[doubtful.reshape(status.shape)] = PixelStatus.BAD_CODE
    return result.place_px, result.sd_px, status


def field(gradient_px: float) -> np.ndarray:
    """Return a map from 32 × 64 pixels to places that runs through many periods, and through the edges between them."""
    row, col = np.mgrid[:32, :64].astype(np.float64)
    return 30.0 + gradient_px * (col + 0.37 * row)


def test_the_lines_of_a_period_are_the_stripes_of_a_sweep_a_period_apart() -> None:
    one = pattern()
    for index in (0, 5, 15):
        shown = gray_line_levels(one, index, device_px=DEVICE_PX).astype(int)
        stripes = range(index, one.places, one.steps)
        swept = sum(stripe_frame(one.as_sweep(), "x", k, device_px=DEVICE_PX).levels.astype(int) for k in stripes)
        np.testing.assert_array_equal(shown, swept)


@given(places=st.integers(20, 900), steps=st.sampled_from([4, 8, 16, 32]), step_px=st.sampled_from([0.5, 1.0, 3.0]))
def test_half_periods_side_by_side_differ_in_one_bit_and_no_two_are_alike(
    places: int, steps: int, step_px: float
) -> None:
    if places <= steps:
        return
    one = pattern(places=places, step_px=step_px, period_px=steps * step_px, width_px=step_px, first_px=4.0)
    device_px = int(places * step_px + 12)
    bits = np.stack([gray_line_levels(one, one.steps + 2 * bit, device_px=device_px) > 127 for bit in range(one.bits)])
    centres = np.arange(one.bars) * one.period_px / 2 + one.period_px / 4 + one.first_px - step_px / 2
    seen = np.unique(np.rint(centres[centres < one.first_px + (places - 1) * step_px]).astype(int))
    number = [tuple(bits[:, place]) for place in seen]
    runs = [number[0]] + [after for before, after in itertools.pairwise(number) if after != before]
    assert len(set(runs)) == len(runs)
    assert all(
        sum(a != b for a, b in zip(one_bar, other, strict=True)) == 1 for one_bar, other in itertools.pairwise(runs)
    )


def test_each_bit_is_shown_with_its_inverse_and_all_is_dark_beyond_the_swept_area() -> None:
    one = pattern(first_px=40.0, places=100)
    for bit in range(one.bits):
        shown, inverse = (
            gray_line_levels(one, one.steps + 2 * bit + k, device_px=DEVICE_PX).astype(int) for k in (0, 1)
        )
        np.testing.assert_array_equal((shown + inverse)[40:140], 255)
        assert not (shown + inverse)[:40].any()
        assert not (shown + inverse)[140:].any()


def test_a_display_of_2048_by_1536_takes_264_photos_with_white_and_black() -> None:
    along_x, along_y = pattern(places=2048), pattern(places=1536)
    assert 4 * (along_x.count + along_y.count + 2) == 264


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"period_px": 15.5}, "even number of steps"),
        ({"width_px": 9.0}, "half of period_px"),
        ({"places": 12}, "more than the 16 steps"),
    ],
)
def test_a_pattern_that_cannot_be_read_back_is_refused(changes: dict[str, float], reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        pattern(**changes)


@pytest.mark.parametrize("footprint_px", [0.6, 1.5, 3.0])
def test_places_are_right_to_their_own_sd_and_no_pixel_is_a_period_off(footprint_px: float) -> None:
    # Two boxes of this width have the variance of the Gaussian footprint: the map's gradient says how wide it is.
    place_px, noise = field(np.sqrt(6) * footprint_px / 1.37 if footprint_px < 2 else 3.0), 2.0
    one = pattern()
    seen = photos(place_px, one, footprint_px=footprint_px, noise=noise)
    found, sd, status = decoded(place_px, one, seen, noise=noise)
    inside = (place_px > 12) & (place_px < DEVICE_PX - 12)
    fine = inside & (status == PixelStatus.OK)
    assert fine.sum() > 0.98 * inside.sum()
    error = found[fine] - place_px[fine]
    assert np.abs(error).max() < one.period_px / 4
    assert np.sqrt(np.mean((error / sd[fine]) ** 2)) < 1.4


def test_noise_that_flips_a_bit_at_an_edge_never_moves_a_pixel_by_a_period() -> None:
    """Every pixel stands on an edge between two half periods, where the bit's two photos are alike but for noise."""
    edge_px = np.repeat(np.arange(2, 30)[:, None] * 8 - 0.5, 40, axis=1)
    one, noise = pattern(), 4.0
    seen = photos(edge_px, one, footprint_px=1.5, noise=noise)
    found, _, status = decoded(edge_px, one, seen, noise=noise)
    fine = status == PixelStatus.OK
    assert (status == PixelStatus.BAD_CODE).mean() < 0.01
    assert fine.mean() > 0.5
    assert np.abs(found[fine] - edge_px[fine]).max() < one.period_px / 4


def test_a_code_that_contradicts_the_lines_is_marked_and_not_believed() -> None:
    place_px = np.full((8, 8), 100.0) + np.arange(8) * 0.5
    one = pattern()
    frames = list(photos(place_px, one, footprint_px=1.0, noise=0.5))
    # A glare over half the pixels hides one bit and its inverse: with it, nothing says which of two far places is seen.
    for index in (one.steps + 2 * 3, one.steps + 2 * 3 + 1):
        frames[index][:4] = 180
    _, _, status = decoded(place_px, one, iter(frames), noise=0.5)
    assert (status[:4] == PixelStatus.BAD_CODE).all()
    assert (status[4:] != PixelStatus.BAD_CODE).all()


def test_a_pixel_that_sees_nothing_has_no_peak() -> None:
    one = pattern()
    dark = np.full((16, one.steps), 5, np.uint8)
    bars = read_bars((np.full(16, 5, np.uint8) for _ in range(2 * one.bits)), one, pixels=16, dark_variance=0.2)
    windows, doubtful = line_windows(dark, bars, one, black=dark[:, 0], dark_variance=0.2)
    assert (windows.peak_index == NO_PEAK).all()
    assert not doubtful.any()


LAYOUT = """
name = "elsewhere"
[object]
name = "glass"
[liquid]
n = 1.33
[display]
columns = 32
rows = 32
pitch_mm = 0.1
[[display_poses]]
centre_mm = [0, 0, 10]
x_axis = [1, 0, 0]
y_axis = [0, 1, 0]
[[display_poses]]
centre_mm = [0, 0, 20]
x_axis = [1, 0, 0]
y_axis = [0, 1, 0]
[camera]
columns = 4
rows = 3
[pattern]
kind = "gray_line"
profile = "hard"
width_px = 4
first_px = 0
step_px = 1
period_px = 16
places = 32
[photos]
stripe = "{set}/{axis}/{number:02d}.png"
"""


def test_a_folder_of_lines_and_bars_is_imported_with_every_photo_it_should_have(tmp_path: Path) -> None:
    (tmp_path / "layout.toml").write_text(LAYOUT)
    layout = read_layout(tmp_path / "layout.toml")
    for one in layout.manifest.sets:
        for axis in ("x", "y"):
            (tmp_path / "photos" / one.name / axis).mkdir(parents=True)
            for number in range(16 + 2 * 2):  # 32 places are four half periods of 8: two bits
                counts = np.full((3, 4), number, np.uint8)
                cv2.imwrite(str(tmp_path / "photos" / one.name / axis / f"{number:02d}.png"), counts)
    assert import_folder(tmp_path / "photos", tmp_path / "session", layout) == 8 * 20
    session = open_session(tmp_path / "session")
    assert not [fault for fault in faults(session) if not fault.is_warning]
    assert isinstance(session.manifest.sets[0].sweeps[0].pattern, GrayLinePattern)


def test_a_range_cannot_narrow_a_code(tmp_path: Path) -> None:
    (tmp_path / "layout.toml").write_text(LAYOUT)
    manifest = read_layout(tmp_path / "layout.toml").manifest
    found = SweepRange(set="pos0_air", axis="x", first_index=0, last_index=9)
    with pytest.raises(SessionError, match="pos0_air/x narrows a sweep of kind 'gray_line', which is always whole"):
        narrowed(manifest, {("pos0_air", "x"): found}, source="journal.jsonl")
