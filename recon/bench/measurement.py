"""One measurement, in a process of its own: wall and processor time, peak memory, and the map that came out."""

import time
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np

from recon.batch.own_processes import OwnProcesses, WorkerLostError
from recon.bench.bench_result import Measurement
from recon.bench.bench_session import BenchSession
from recon.bench.contestants import CONTESTANTS, FULL, PAPER, sweep_files
from recon.errors import ReconError
from recon.sessions.session import open_session
from recon.stage_timer import peak_memory_mb

# What a sweep loads, with the compiler, when it is decoded; the paper's needs no fit.
LOADED_WHEN_NEEDED = {
    PAPER: ("recon.sweeps.peak_tracker",),
    FULL: ("recon.sweeps.peak_tracker", "recon.sweeps.likelihood"),
}


def own_processes() -> OwnProcesses:
    """Return what gives every measurement a process of its own, one at a time, with the libraries loaded when it starts."""
    return OwnProcesses(1, threads=1, preload=(__name__,))


def measured(
    processes: OwnProcesses, session: BenchSession, contestant: str, *, threads: int, map_file: Path | None = None
) -> Measurement:
    """Run a contestant in a new process, once in each of ``threads`` threads at the same time; keep its map as ``.npy``."""
    try:
        found: Measurement = processes.submit(_measure, session, contestant, threads, map_file).result()
    except WorkerLostError as error:
        raise ReconError(
            f"the measurement of {contestant} on {session.photos} photos was ended from outside ({error}); "
            "memory may be short: try fewer photos or a smaller size"
        ) from None
    return found


def _measure(session: BenchSession, contestant: str, threads: int, map_file: Path | None) -> Measurement:
    # The threads of a measurement are those that it was given: one sweep each.
    cv2.setNumThreads(1)
    opened = open_session(session.folder)
    for path in sweep_files(opened):
        path.read_bytes()  # no contestant waits for the disk
    run = CONTESTANTS[contestant]
    for module in LOADED_WHEN_NEEDED.get(contestant, ()):
        import_module(module)
    at_start_mb = peak_memory_mb()
    with ThreadPoolExecutor(threads) as pool:
        wall_s, processor_s = time.perf_counter(), time.process_time()
        maps = list(pool.map(run, [opened] * threads))
        wall_s, processor_s = time.perf_counter() - wall_s, time.process_time() - processor_s
    after_mb = peak_memory_mb()
    if map_file is not None and maps[0] is not None:
        np.save(map_file, maps[0])
    camera = opened.manifest.camera
    return Measurement(
        contestant=contestant,
        photos=session.photos,
        file_mb=session.file_mb,
        threads=threads,
        wall_s=wall_s,
        processor_s=processor_s,
        megapixels_per_s=threads * session.photos * camera.rows * camera.columns / 1e6 / wall_s,
        at_start_mb=at_start_mb,
        peak_mb=after_mb,
    )
