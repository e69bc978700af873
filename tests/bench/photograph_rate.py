"""How fast the simulator traces and photographs: ``python -m tests.bench.photograph_rate`` prints JSON."""

import argparse
import json
import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from drivers.protocols import Axis, Frame
from recon.stage_timer import peak_memory_mb
from sim_backend.photography import Photographer
from sim_backend.scene import Scene, load_scene


def stripe(scene: Scene, axis: Axis, place: int) -> Frame:
    """Return a raised cosine of the scene's width at a device pixel."""
    count = scene.display.columns if axis == "x" else scene.display.rows
    distance = np.abs(np.arange(count) - place) / scene.stripe.width_px
    levels = np.where(distance < 0.5, 0.5 + 0.5 * np.cos(2 * np.pi * distance), 0.0)
    return Frame(axis, np.round(255 * levels).astype(np.uint8))


def measure(scene: Scene, *, photos: int, threads: int) -> dict[str, float]:
    """Trace all four sets, then time ``photos`` photos with noise and JPEG on ``threads`` threads."""
    photographer = Photographer(scene)
    conditions = [{"wet": False}, {"wet": True}]
    if scene.method == "thin":
        conditions = [{"wet": False}, {"wet": False, "object_present": False}]
    started, started_cpu = time.perf_counter(), time.process_time()
    sets = [{"stage_position_mm": place, **condition} for condition in conditions for place in scene.stage_positions_mm]
    axes: tuple[Axis, Axis] = ("x", "y")
    for settings in sets:
        for axis in axes:
            photographer.photograph(stripe(scene, axis, 0), **settings)
    traced, traced_cpu = time.perf_counter(), time.process_time()

    def take(number: int) -> int:
        axis = axes[number % 2]
        count = scene.display.columns if axis == "x" else scene.display.rows
        frame = stripe(scene, axis, number * 7 % count)
        return len(photographer.photograph(frame, **sets[number * len(sets) // photos]))

    with ThreadPoolExecutor(threads) as pool:
        size = sum(pool.map(take, range(photos)))
    done, done_cpu = time.perf_counter(), time.process_time()
    return {
        "tracing_s": round(traced - started, 2),
        "tracing_cpu_s": round(traced_cpu - started_cpu, 2),
        "photos_per_s": round(photos / (done - traced), 1),
        "cpu_ms_per_photo": round(1000 * (done_cpu - traced_cpu) / photos, 2),
        "bytes_per_photo": size / photos,
        "peak_memory_mb": peak_memory_mb(),
    }


def with_rows(scene: Scene, rows: int) -> Scene:
    """Return the scene with another number of rows about the middle of the photo."""
    camera = scene.camera
    middle = camera.centre_y_px + (rows - camera.rows) / 2
    return scene.model_copy(update={"camera": camera.model_copy(update={"rows": rows, "centre_y_px": middle})})


def main() -> None:
    """Measure one scene at one size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="semi_ellipsoid")
    parser.add_argument("--camera-columns", type=int, default=1024)
    parser.add_argument("--camera-rows", type=int, help="rows about the middle of the photo")
    parser.add_argument("--display-columns", type=int, default=1024)
    parser.add_argument("--photos", type=int, default=400)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    given = parser.parse_args()
    scene = load_scene(given.scene).resized(camera_columns=given.camera_columns, display_columns=given.display_columns)
    if given.camera_rows is not None:
        scene = with_rows(scene, given.camera_rows)
    result = measure(scene, photos=given.photos, threads=given.threads)
    print(json.dumps({**vars(given), **result}, indent=2))


if __name__ == "__main__":
    main()
