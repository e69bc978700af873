"""A long capture with a camera that misbehaves: ``python -m tests.bench.camera_soak`` prints JSON.

The real driver and the real libgphoto2 photograph with an emulated body; before every tenth photo on average one fault is
set. Every photo that arrives must be the very one that the shutter took last. A photo that the driver refuses is taken again,
as the sequencer's operator would by resuming.
"""

import argparse
import json
import random
import sys
import time
from collections import Counter
from pathlib import Path

from drivers.errors import DeviceError
from drivers.gphoto2_camera import Gphoto2Camera
from sim_backend.ptpip.process import MODELS, EmulatedCamera, emulate_camera
from sim_backend.ptpip.sources import drawn_photos
from sim_backend.ptpip.world_photos import numbered

FAULTS = ("busy", "stale", "truncated", "stray", "stray_in_capture", "dropped_link", "lost")
FAULT_RATE = 0.1
TIMEOUT_S = 60.0
ATTEMPT_S = 2.0


class Photos:
    """Twenty pictures in turn, each photo with its number; remembers the last one."""

    def __init__(self) -> None:
        draw = drawn_photos()
        self._pictures = [draw() for _ in range(20)]
        self.count = 0
        self.last = b""

    def __call__(self) -> bytes:
        """Take a photo."""
        self.count += 1
        self.last = numbered(self._pictures[self.count % len(self._pictures)], self.count)
        return self.last


def resident_mb(process_id: int) -> float:
    """Return the memory of a process."""
    lines = Path(f"/proc/{process_id}/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def take(camera: Gphoto2Camera, photos: Photos, refused: Counter[str]) -> bool:
    """Take one photo, again as often as the driver refuses it; return whether it is the right one."""
    while True:
        try:
            camera.expose(timeout_s=TIMEOUT_S)
            (photo,) = camera.collect(timeout_s=TIMEOUT_S)
            return photo.data == photos.last
        except DeviceError as error:
            refused[type(error).__name__] += 1


def soak(body: EmulatedCamera, photos: Photos, *, count: int, seed: int) -> dict[str, object]:
    """Take ``count`` photos with faults between them."""
    rng = random.Random(seed)
    injected: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    wrong, slowest_s, started_s = 0, 0.0, time.monotonic()
    with Gphoto2Camera(body.address, kind="emulated", attempt_s=ATTEMPT_S) as camera:
        take(camera, photos, refused)
        before_mb = resident_mb(camera._link.opened()._process.pid)
        for _ in range(count):
            if rng.random() < FAULT_RATE:
                fault = rng.choice(FAULTS)
                body.set_faults(**{fault: 1})
                injected[fault] += 1
            begun_s = time.monotonic()
            wrong += not take(camera, photos, refused)
            slowest_s = max(slowest_s, time.monotonic() - begun_s)
        counts = camera.counts
        after_mb = resident_mb(camera._link.opened()._process.pid)
    elapsed_s = time.monotonic() - started_s
    return {
        "photos": count,
        "wrong_photos": wrong,
        "photos_per_s": round(count / elapsed_s, 1),
        "slowest_photo_s": round(slowest_s, 2),
        "faults_injected": dict(injected),
        "refused_photos": dict(refused),
        "strays": counts.strays,
        "retaken": counts.retaken,
        "recoveries": counts.recoveries,
        "library_memory_mb": [round(before_mb, 1), round(after_mb, 1)],
    }


def main() -> None:
    """Soak every model and print what happened; end with 1 if a wrong photo got through."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--photos", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    given = parser.parse_args()
    results = {}
    for model in given.models:
        photos = Photos()
        with emulate_camera(photos, model=model) as body:
            results[model] = soak(body, photos, count=given.photos, seed=given.seed)
    sys.stdout.write(json.dumps(results, indent=2) + "\n")
    raise SystemExit(any(result["wrong_photos"] for result in results.values()))


if __name__ == "__main__":
    main()
