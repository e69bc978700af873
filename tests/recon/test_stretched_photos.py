"""Photos of fewer bits in files of 16: stretched, so that counts come in steps of 257, or shifted, so that they end in zeros."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.bench.bench_scene import STRIPE_COUNTS, STRIPE_WIDTH_PX, BenchScene, bench_scene
from recon.bench.bench_session import SET_NAME, manifest_of
from recon.patterns.pattern_frames import pattern_frame
from recon.sessions.manifest import Axis, Sweep
from recon.sessions.pattern import GrayLinePattern, Pattern, PhaseShiftPattern
from recon.sessions.photos import saturation_count
from recon.sessions.session import Session, SessionWriter, open_session
from recon.status import PixelStatus
from recon.sweeps.black_level import step_of_counts
from recon.sweeps.correspondence import decode_sweep
from recon.sweeps.decode_pattern import decode_pattern

PHOTOS, DARK = 40, 6
STRETCH = 257
AXES: tuple[Axis, Axis] = ("x", "y")
# A dark sample shows one count more as seldom as this: the noise is far below the step of 8 bits.
FLICKER = 1 / 200
# Places of a stripe whose clipped top is left out err by 0.003 px; with the flat top for a curve they would by 0.012.
WITHOUT_TOP_PX = 0.006


def photos_of(scene: BenchScene) -> list[np.ndarray]:
    """Return the black photo and those of the sweep in 8 bits."""
    rng = np.random.default_rng(3)
    made = []
    for index in (None, *range(PHOTOS)):
        light = np.zeros(scene.place_px.shape)
        if index is not None:
            distance = scene.place_px - index
            near = scene.lit & (np.abs(distance) < STRIPE_WIDTH_PX / 2)
            light[near] = STRIPE_COUNTS / 2 * (1 + np.cos(2 * np.pi / STRIPE_WIDTH_PX * distance[near]))
        made.append((DARK + np.rint(light) + (rng.random(light.shape) < FLICKER)).astype(np.uint8))
    return made


def session_of(folder: Path, scene: BenchScene, photos: list[np.ndarray], pattern: Pattern | None = None) -> Session:
    manifest = manifest_of(scene)
    if pattern is not None:
        sets = [
            one.model_copy(update={"sweeps": tuple(Sweep(axis=axis, pattern=pattern) for axis in AXES)})
            for one in manifest.sets
        ]
        manifest = manifest.model_copy(update={"sets": tuple(sets)})
    with SessionWriter.create(folder, manifest) as writer:
        for number, counts in enumerate(photos):
            sweep, index = ("black", 0) if number == 0 else ("x", number - 1)
            data = cv2.imencode(".png", counts)[1].tobytes()
            writer.save_photo(data, set_name=SET_NAME, sweep=sweep, index=index, suffix=".png")
    return open_session(folder)


@pytest.mark.parametrize("method", ["paper", "full"])
def test_a_flicker_by_one_step_is_no_light(tmp_path: Path, method: str) -> None:
    scene = bench_scene(columns=120, photos=PHOTOS, seed=0)
    stretched = [counts.astype(np.uint16) * STRETCH for counts in photos_of(scene)]
    session = session_of(tmp_path / "session", scene, stretched)
    status = decode_sweep(session, session.manifest.sets[0], "x", method=method).status
    # Forty photos of a dark pixel flicker at least once in one pixel of six; twice in the same sample never.
    assert (status[~scene.lit] == PixelStatus.UNLIT).mean() > 0.999
    assert (status[scene.lit] == PixelStatus.UNLIT).mean() < 0.01


@pytest.mark.parametrize(("dtype", "step", "offset"), [(np.uint16, 257, 0), (np.uint16, 16, 5), (np.uint16, 1, 0)])
def test_the_step_of_counts_is_found_where_there_are_many_of_them(dtype: type, step: int, offset: int) -> None:
    levels = np.random.default_rng(4).integers(0, 200, (40, 50))
    assert step_of_counts((levels * step + offset).astype(dtype)) == step
    # Two levels have any step.
    assert step_of_counts((levels % 2 * 1000).astype(dtype)) == 1


CODES: tuple[Pattern, ...] = (
    GrayLinePattern(
        kind="gray_line", profile="raised_cosine", width_px=4.0, first_px=0.0, step_px=1.0, period_px=8.0, places=40
    ),
    PhaseShiftPattern(kind="phase_shift", periods_px=(48.0, 12.0), steps=8, first_px=0.0, last_px=39.0),
)


@pytest.mark.parametrize("pattern", CODES, ids=lambda one: one.kind)
def test_a_flicker_by_one_step_is_no_light_in_codes_either(tmp_path: Path, pattern: Pattern) -> None:
    scene = bench_scene(columns=120, photos=PHOTOS, seed=0)
    rng = np.random.default_rng(5)
    light = [np.zeros(scene.lit.shape)]
    for index in range(pattern.count):
        levels = pattern_frame(pattern, "x", index, device_px=64).levels.ravel()
        light.append(np.where(scene.lit, np.interp(scene.place_px, np.arange(64), levels) * 0.6, 0.0))
    photos = [DARK + np.rint(one) + (rng.random(one.shape) < FLICKER) for one in light]
    stretched = [one.astype(np.uint16) * STRETCH for one in photos]
    session = session_of(tmp_path / "session", scene, stretched, pattern)
    status = decode_pattern(session, session.manifest.sets[0], "x", method="full").status
    assert (status[~scene.lit] == PixelStatus.UNLIT).mean() > 0.999
    assert (status[scene.lit] == PixelStatus.UNLIT).mean() < 0.01


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_shifted_samples_are_clipped_at_the_top_of_their_own_bits(bits: int) -> None:
    levels = np.random.default_rng(6).integers(0, 2**bits - 10, (40, 50))
    levels[0, :3] = 2**bits - np.array([1, 2, 3])
    counts = (levels << (16 - bits)).astype(np.uint16)
    clipped = np.zeros(levels.shape, bool)
    # The top, and one step below it.
    clipped[0, :2] = True
    np.testing.assert_array_equal(counts >= saturation_count(counts), clipped)


def test_dark_photos_and_photos_of_few_levels_tell_no_top_far_below_that_of_16_bits() -> None:
    assert saturation_count(np.zeros((4, 5), np.uint16)) == 65534
    assert saturation_count(np.full((4, 5), 1 << 15, np.uint16)) == 254 << 8


def test_a_clipped_stripe_of_shifted_photos_is_told_and_fitted_without_its_top(tmp_path: Path) -> None:
    scene = bench_scene(columns=120, photos=PHOTOS, seed=0)
    light = [np.minimum(2.0 * (one.astype(float) - DARK) + DARK, 255.0) for one in photos_of(scene)]
    black = np.zeros(scene.lit.shape)
    shifted = [np.rint(one).astype(np.uint16) << 8 for one in (black, *light[1:])]
    session = session_of(tmp_path / "session", scene, shifted)
    found = decode_sweep(session, session.manifest.sets[0], "x", method="full")
    assert max(photo.saturated_share for photo in found.photos) > 0.01
    # The clipped top is left out of the fit, not taken for the shape of the curve: places stay those of the scene.
    there = scene.lit & (found.status == PixelStatus.OK)
    assert there.sum() > 0.95 * scene.lit.sum()
    error = (found.place_px - scene.place_px)[there]
    assert np.sqrt(np.mean(error**2)) < WITHOUT_TOP_PX
