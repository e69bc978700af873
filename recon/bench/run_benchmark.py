"""A whole ``recon run`` beside decoding its photos alone: both on the same session, each in a process of its own."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np

from recon.batch.own_processes import OwnProcesses, WorkerLostError
from recon.bench.bench_scene import ASPECT
from recon.bench.benchmark import FIRST_COLUMNS, FIRST_PHOTOS, LIBRARIES, PAPER_PIXELS
from recon.bench.machine import machine
from recon.bench.run_result import FoundSurface, RunBenchResult, RunPhotos, RunStage
from recon.bench.run_scene import radial_error_mm
from recon.bench.run_session import RunSession, kept_or_written
from recon.errors import ReconError
from recon.maps import MAPS_NAME, load_maps
from recon.method import Method
from recon.metrics import StageTime
from recon.run import run_session
from recon.running.settings import Settings
from recon.sessions.photos import read_grey
from recon.sessions.session import Session, open_session
from recon.stage_timer import peak_memory_mb

DECODING, RUN = "decoding alone", "recon run"
RESULT_NAME = "result"
# More pixels than are fitted without a lattice, and than are factorised.
FIRST_MEGAPIXELS = 0.03


def run_benchmark(
    folder: Path,
    *,
    columns: int,
    photos: int,
    object_megapixels: float,
    photo_mb: float,
    method: Method,
    threads: int,
    seed: int,
    command: str,
    say: Callable[[str], None],
) -> RunBenchResult:
    """Measure decoding and running on a session of eight sweeps of ``photos`` photos, which is written to ``folder``.

    ``photo_mb`` is the size of a photo of 3888 × 2592 pixels, others in proportion. Raises ``ReconError`` where one dies.
    """
    rows = round(columns * ASPECT)
    before = machine()
    made = kept_or_written(
        folder,
        columns=columns,
        photos=photos,
        object_megapixels=object_megapixels,
        photo_bytes=photo_mb * 1e6 * rows * columns / PAPER_PIXELS,
        seed=seed,
        say=say,
    )
    first = kept_or_written(
        folder / "first",
        columns=FIRST_COLUMNS,
        photos=FIRST_PHOTOS,
        object_megapixels=FIRST_MEGAPIXELS,
        photo_bytes=photo_mb * 1e6,
        seed=seed,
        say=lambda _: None,
    )
    with OwnProcesses(1, threads=threads, preload=(__name__,)) as processes:

        def measured(
            what: Callable[..., tuple[RunStage, ...]], session: RunSession, *given: object
        ) -> tuple[RunStage, ...]:
            try:
                found: tuple[RunStage, ...] = processes.submit(what, session.folder, *given).result()
            except WorkerLostError as error:
                raise ReconError(
                    f"the measurement was ended from outside ({error}); memory may be short: try fewer photos or a smaller size"
                ) from None
            return found

        say("a small session first, so that every loop is compiled before anything is timed")
        measured(_run, first, folder / "first" / RESULT_NAME, method, threads)
        say(f"decoding every photo, one sweep a thread, threads {threads}")
        (decoding,) = measured(_decode, made, threads)
        say(f"running the whole reconstruction, threads {threads}")
        *stages, run = measured(_run, made, folder / RESULT_NAME, method, threads)
    return RunBenchResult(
        command=command,
        machine=before.model_copy(update={"load_after": machine().load_before}),
        versions={name: version(name) for name in LIBRARIES},
        method=method,
        threads=threads,
        photos=RunPhotos(
            file_mb=made.file_mb,
            quality=made.quality,
            photos=made.photos,
            photos_a_sweep=photos,
            columns=columns,
            rows=rows,
            object_megapixels=object_megapixels,
        ),
        decoding=decoding,
        run=run,
        stages=tuple(stages),
        over_decoding_wall=run.wall_s / decoding.wall_s,
        over_decoding_processor=run.processor_s / decoding.processor_s,
        surface=_found_surface(folder / RESULT_NAME / MAPS_NAME, object_megapixels=object_megapixels),
    )


def _decode(folder: Path, threads: int) -> tuple[RunStage, ...]:
    """Decode every photo, one sweep a thread, and do nothing else."""
    cv2.setNumThreads(1)
    session = open_session(folder)
    _read(session)

    def decode(sweep: list[Path]) -> None:
        camera = session.manifest.camera
        buffer = None
        for path in sweep:
            buffer = read_grey(path, rows=camera.rows, cols=camera.columns, buffer=buffer)

    with ThreadPoolExecutor(threads) as pool:
        wall_s, processor_s = time.perf_counter(), time.process_time()
        list(pool.map(decode, _sweeps(session)))
        wall_s, processor_s = time.perf_counter() - wall_s, time.process_time() - processor_s
    return (RunStage(name=DECODING, wall_s=wall_s, processor_s=processor_s, peak_mb=peak_memory_mb()),)


def _run(folder: Path, out: Path, method: Method, threads: int) -> tuple[RunStage, ...]:
    """Run the whole reconstruction, and keep nothing of an earlier one."""
    _read(open_session(folder))
    stages: list[RunStage] = []
    begun = latest = time.process_time()

    def on_stage(stage: StageTime) -> None:
        nonlocal latest
        now = time.process_time()
        stages.append(RunStage(name=stage.name, wall_s=stage.wall_s, processor_s=now - latest, peak_mb=stage.peak_mb))
        latest = now

    wall_s = time.perf_counter()
    run_session(folder, out, Settings(method=method, threads=threads, force=True), on_stage=on_stage)
    wall_s = time.perf_counter() - wall_s
    whole = RunStage(name=RUN, wall_s=wall_s, processor_s=time.process_time() - begun, peak_mb=peak_memory_mb())
    return (*stages, whole)


def _sweeps(session: Session) -> list[list[Path]]:
    """Return the photos of every sweep in order."""
    return [
        [session.photo_file(one.name, sweep.axis, index) for index in session.photo_numbers(one, sweep.axis)]
        for one in session.manifest.sets
        for sweep in one.sweeps
    ]


def _read(session: Session) -> None:
    """Read every photo once, so that no measurement waits for the disk as long as the system's cache holds them."""
    for sweep in _sweeps(session):
        for path in sweep:
            path.read_bytes()


def _found_surface(maps_file: Path, *, object_megapixels: float) -> FoundSurface:
    """Compare the points with the surface that the scene has."""
    maps = load_maps(maps_file)
    point_mm = maps.point_mm[maps.valid()]
    if not len(point_mm):
        return FoundSurface(share=0.0, error_rms_mm=float("nan"), error_median_mm=float("nan"))
    error_mm = radial_error_mm(point_mm)
    return FoundSurface(
        share=len(point_mm) / (1e6 * object_megapixels),
        error_rms_mm=float(np.sqrt(np.mean(error_mm**2))),
        error_median_mm=float(np.median(np.abs(error_mm))),
    )
