"""How long fusion takes, and how it grows with the pixels of the surface: a table of four sizes.

python -m tests.bench.fusion_speed [--pixels 0.25 1 4 10] [--threads 2] [--without-refinement] [--out speed.json]

The surface is a ball's cap in closed form, met by converging rays, with Gaussian noise on distances (a hundredth of the ball's
radius) and normals (0.3°). As many threads as `recon run` would take share the work. Every size has a process of its own, whose
largest memory is told with it.
"""

import argparse
import json
import math
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from recon.batch.cores import usable_cores
from recon.stage_timer import peak_memory_mb
from recon.surface.fusion import fuse_on_rays
from recon.surface.refinement import refine_surface

RADIUS_MM, DISTANCE_MM = 28.0, 60.0
DISTANCE_SD_MM, NORMAL_SD_RAD = 0.28, math.radians(0.3)
SIZES = (0.25, 1.0, 4.0, 10.0)
# As many as are not factorised but solved by multigrid.
FIRST_PIXELS = 5000.0


@dataclass(frozen=True, slots=True)
class Timed:
    """One size: megapixels of the surface, seconds of fusion and of refinement, peak memory, and the error that is left."""

    megapixels: float
    fusion_s: float
    fusion_cpu_s: float
    refinement_s: float | None
    refinement_cpu_s: float | None
    peak_gb: float
    error_rms_mm: float


def cap(pixels: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return point, normal, direction and mask of a cap on a square grid, with about so many pixels."""
    size = round(math.sqrt(pixels * 4 / math.pi))
    axis = np.linspace(-21.5, 21.5, size)
    x, y = np.meshgrid(axis, axis)
    mask = x**2 + y**2 < 21.5**2
    point = np.stack([x, y, np.sqrt(np.maximum(RADIUS_MM**2 - x**2 - y**2, 0.0))], axis=2)
    direction = np.stack([-0.02 * x, -0.015 * y + 0.1, -np.ones_like(x)], axis=2)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    return point, point / RADIUS_MM, direction, mask


def timed(pixels: float, *, threads: int, with_refinement: bool) -> Timed:
    """Fuse a cap with noise, and refine it if asked."""
    point, normal, direction, mask = cap(pixels)
    rng = np.random.default_rng(1)
    tilt = rng.standard_normal(point.shape) * NORMAL_SD_RAD / math.sqrt(2)
    measured = normal + tilt
    measured /= np.linalg.norm(measured, axis=2, keepdims=True)
    ones = np.ones(mask.shape)
    distance = DISTANCE_MM + DISTANCE_SD_MM * rng.standard_normal(mask.shape)
    start, start_cpu = time.perf_counter(), time.process_time()
    fused = fuse_on_rays(
        point - DISTANCE_MM * direction,
        direction,
        distance,
        DISTANCE_SD_MM * ones,
        measured,
        NORMAL_SD_RAD * ones,
        mask,
        threads=threads,
    )
    middle, middle_cpu = time.perf_counter(), time.process_time()
    refinement_s = refinement_cpu_s = None
    if with_refinement:
        shift = np.broadcast_to(1e-4 * np.eye(3), (*mask.shape, 3, 3))
        refine_surface(fused, direction, measured, NORMAL_SD_RAD * ones, shift, threads=threads)
        refinement_s, refinement_cpu_s = time.perf_counter() - middle, time.process_time() - middle_cpu
    return Timed(
        megapixels=float(mask.sum()) / 1e6,
        fusion_s=middle - start,
        fusion_cpu_s=middle_cpu - start_cpu,
        refinement_s=refinement_s,
        refinement_cpu_s=refinement_cpu_s,
        peak_gb=peak_memory_mb() / 1e3,
        error_rms_mm=float(np.sqrt(np.nanmean((fused.distance_mm - DISTANCE_MM) ** 2))),
    )


def main() -> None:
    """Time every size in a process of its own, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pixels", type=float, nargs="+", default=list(SIZES), metavar="MPX")
    parser.add_argument("--threads", type=int, default=usable_cores())
    parser.add_argument("--without-refinement", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--one", type=float, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one is not None:
        # The loops that are compiled when they are first called are no part of the time.
        timed(FIRST_PIXELS, threads=given.threads, with_refinement=True)
        row = timed(given.one * 1e6, threads=given.threads, with_refinement=not given.without_refinement)
        print(json.dumps(asdict(row)))
        return
    rows: list[Timed] = []
    print(
        "| Mpx | fusion (s) | s a Mpx | CPU s a Mpx | over n log n | refinement (s) | CPU s a Mpx | peak (GB) | error RMS (mm) |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for size in given.pixels:
        command = [
            sys.executable,
            "-m",
            "tests.bench.fusion_speed",
            "--one",
            str(size),
            "--threads",
            str(given.threads),
        ]
        command += ["--without-refinement"] if given.without_refinement else []
        ran = subprocess.run(command, check=True, capture_output=True, text=True)
        rows.append(Timed(**json.loads(ran.stdout)))
        print(_line(rows[-1], rows[0]), flush=True)
    if given.out is not None:
        given.out.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")


def _line(row: Timed, first: Timed) -> str:
    """Return a row of the table; growth is the CPU time over n log n, that of the first row being 1."""

    def over(one: Timed) -> float:
        return one.fusion_cpu_s / (one.megapixels * math.log(one.megapixels * 1e6))

    refinement = "– | –"
    if row.refinement_s is not None and row.refinement_cpu_s is not None:
        refinement = f"{row.refinement_s:.1f} | {row.refinement_cpu_s / row.megapixels:.1f}"
    return (
        f"| {row.megapixels:.2f} | {row.fusion_s:.1f} | {row.fusion_s / row.megapixels:.1f} "
        f"| {row.fusion_cpu_s / row.megapixels:.1f} "
        f"| {over(row) / over(first):.2f} | {refinement} | {row.peak_gb:.1f} | {row.error_rms_mm:.4f} |"
    )


if __name__ == "__main__":
    main()
