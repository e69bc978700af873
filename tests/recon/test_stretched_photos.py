"""Photos of 8 bits that some program stretched to 16: their counts come in steps of 257."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.bench.bench_scene import STRIPE_COUNTS, STRIPE_WIDTH_PX, BenchScene, bench_scene
from recon.bench.bench_session import SET_NAME, manifest_of
from recon.sessions.session import Session, SessionWriter, open_session
from recon.status import PixelStatus
from recon.sweeps.black_level import step_of_counts
from recon.sweeps.correspondence import decode_sweep

PHOTOS, DARK = 40, 6
STRETCH = 257
# A dark sample shows one count more as seldom as this: the noise is far below the step of 8 bits.
FLICKER = 1 / 200


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


def session_of(folder: Path, scene: BenchScene, photos: list[np.ndarray]) -> Session:
    with SessionWriter.create(folder, manifest_of(scene)) as writer:
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
