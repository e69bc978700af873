"""The benchmark: its contestants do the same work on the same photos, and its ratios are those of its measurements."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.bench.bench_result import Measurement
from recon.bench.bench_scene import bench_scene, photo
from recon.bench.bench_session import BenchSession, encoded, quality_of, write_bench_sessions
from recon.bench.benchmark import ratio_of_one_more_photo, ratios
from recon.bench.contestants import DECODING, PAPER, RUNNING, paper_sweep, running_argmax, stack_argmax, sweep_files
from recon.bench.measurement import measured, own_processes
from recon.bench.run_scene import radial_error_mm, run_scene
from recon.errors import ReconError
from recon.method import Limits
from recon.reconstruct import cross_paths
from recon.sessions.session import Session, open_session
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.noise import NoiseModel
from recon.sweeps.set_places import AXES

COLUMNS, ROWS, PHOTOS = 96, 64, 32
WANTED_BYTES = (1500.0, 2500.0)
# Colours and back: two roundings by half a count, in each of the two photos.
ROUNDING_COUNTS = 2


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> tuple[BenchSession, ...]:
    folder = tmp_path_factory.mktemp("bench")
    return write_bench_sessions(folder, columns=COLUMNS, photos=PHOTOS, photo_bytes=WANTED_BYTES, seed=0)


@pytest.fixture(scope="module")
def opened(sessions: tuple[BenchSession, ...]) -> Session:
    return open_session(sessions[-1].folder)


def test_a_photo_is_as_large_as_wanted_or_a_little_smaller() -> None:
    colours = photo(bench_scene(columns=COLUMNS, photos=PHOTOS, seed=0), PHOTOS // 2, rng=np.random.default_rng(0))
    for wanted in WANTED_BYTES:
        quality = quality_of(colours, wanted)
        assert len(encoded(colours, quality)) <= wanted < len(encoded(colours, quality + 1))


def test_every_lit_pixel_is_placed_where_the_scene_put_it(opened: Session) -> None:
    scene = bench_scene(columns=COLUMNS, photos=PHOTOS, seed=0)
    place = paper_sweep(opened)
    assert np.isfinite(place[scene.lit]).mean() > 0.99
    # A parabola through samples of a cosine is wrong by less than a tenth of a step; noise adds as much again.
    assert np.nanmedian(np.abs(place - scene.place_px)[scene.lit]) < 0.1


def test_naive_scripts_and_our_sweep_find_the_same_brightest_photo_of_every_lit_pixel(opened: Session) -> None:
    grey = np.stack([cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sweep_files(opened)]).astype(int)
    place = paper_sweep(opened)
    placed = np.isfinite(place)
    number = stack_argmax(opened)
    # A parabola's vertex lies within half a step of the brightest sample.
    assert (np.abs(place - number)[placed] <= 0.5).all()
    running = running_argmax(opened)
    lost = grey.max(axis=0) - np.take_along_axis(grey, running[None], axis=0)[0]
    assert lost[placed].max() <= ROUNDING_COUNTS


def test_a_measurement_of_its_own_process_counts_every_thread(
    sessions: tuple[BenchSession, ...], tmp_path: Path
) -> None:
    with own_processes() as processes:
        one = measured(processes, sessions[0], PAPER, threads=2, map_file=tmp_path / "map.npy")
    assert one.wall_s > 0
    assert one.processor_s > 0
    assert one.megapixels_per_s == pytest.approx(2 * PHOTOS * COLUMNS * ROWS / 1e6 / one.wall_s)
    assert 0 < one.at_start_mb <= one.peak_mb
    assert np.load(tmp_path / "map.npy").shape == (ROWS, COLUMNS)


def test_ratios_compare_the_same_files_with_the_same_threads() -> None:
    found = [
        _measurement(DECODING, file_mb=1.0, wall_s=2.0),
        _measurement(PAPER, file_mb=1.0, wall_s=3.0),
        _measurement(DECODING, file_mb=2.0, wall_s=4.0),
        _measurement(PAPER, file_mb=2.0, wall_s=5.0),
        _measurement(RUNNING, file_mb=2.0, wall_s=20.0),
        _measurement(PAPER, file_mb=3.0, wall_s=1.0, photos=PHOTOS // 2),
    ]
    made = {(one.contestant, one.file_mb): (one.wall, one.over) for one in ratios(found, photos=PHOTOS)}
    assert made == {(PAPER, 1.0): (1.5, DECODING), (PAPER, 2.0): (1.25, DECODING), (RUNNING, 2.0): (4.0, PAPER)}


def test_one_more_photo_costs_the_difference_of_two_lengths() -> None:
    short, usual = (BenchSession(Path(), photos, 90, file_mb) for photos, file_mb in ((10, 1.0), (30, 2.0)))
    found = [
        _measurement(DECODING, file_mb=2.0, wall_s=3.0, photos=30),  # 0.1 s a photo
        _measurement(PAPER, file_mb=2.0, wall_s=9.0, photos=30),
        _measurement(PAPER, file_mb=1.0, wall_s=5.0, photos=10),  # 4 s for 20 photos more: 0.2 s a photo
    ]
    made = ratio_of_one_more_photo(found, short, usual)
    assert made.wall == pytest.approx(2.0)


def _measurement(contestant: str, *, file_mb: float, wall_s: float, photos: int = PHOTOS) -> Measurement:
    return Measurement(
        contestant=contestant,
        photos=photos,
        file_mb=file_mb,
        threads=1,
        wall_s=wall_s,
        processor_s=wall_s,
        megapixels_per_s=1.0,
        at_start_mb=1.0,
        peak_mb=1.0,
    )


def test_the_places_of_the_whole_session_cross_on_the_surface_of_its_scene() -> None:
    scene = run_scene(columns=COLUMNS, photos=PHOTOS, object_megapixels=2e-3)
    manifest = scene.manifest
    shape = (manifest.camera.rows, manifest.camera.columns)
    lit = np.zeros(shape, dtype=bool)
    lit.ravel()[scene.pixels] = True
    sweeps = {}
    for one in manifest.sets:
        for axis in AXES:
            place_px = np.full(shape, np.nan)
            place_px[lit] = scene.place_px(one, axis)
            # Beyond the first and the last stripe nothing would be seen.
            assert 2 < np.nanmin(place_px) < np.nanmax(place_px) < PHOTOS - 3
            sweeps[one.name, axis] = SweepResult(
                place_px=place_px,
                sd_px=np.where(lit, 0.01, np.nan).astype(np.float32),
                status=np.where(lit, PixelStatus.OK, PixelStatus.UNLIT).astype(np.uint8),
                noise=NoiseModel(1.0),
                misfit=np.nan,
                photos=(),
                curves=(),
            )
    _, crossing = cross_paths(sweeps, manifest, method="full", limits=Limits())
    fine = crossing.status == PixelStatus.OK
    assert fine.mean() > 0.9
    # Places have single precision, 1e-7 of the display's 112 mm, and a crossing at 0.1 rad takes ten times as much.
    assert np.abs(radial_error_mm(crossing.points.point_mm[fine])).max() < 1e-3


def test_an_object_larger_than_the_photo_is_refused() -> None:
    with pytest.raises(ReconError, match="a photo of 96 x 64 px holds one of"):
        run_scene(columns=COLUMNS, photos=PHOTOS, object_megapixels=0.004)
