"""How fast a capture is, apart from its camera: ``python -m tests.bench.capture_rate`` prints JSON.

``rate``: photos a second of the same capture with simulated devices and through the wire (libgphoto2 on PTP/IP, Chromium, ptys),
on the simulated clock and without any delay of a device, so that what is left is our own work and the drivers'.

``overhead``: a capture in real time with a camera that takes 0.5 s a photo, and with live decoding. The time within sweeps,
from their first photo to their last, over the camera's own time; what was waited for the display to settle is left out, and
told. With the frame tag read (the next frame is shown while the photo is on its way) and without (it is not).
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg
from rich.console import Console

from drivers.protocols import Clock
from recon.patterns.frame_tag_reading import find_tag
from recon.sessions.journal import read_photos
from rig.capturing.capture import capture
from rig.config import RigConfig, parse_config
from rig.devices import open_devices
from rig.planning.plan import all_photos, set_name, set_order
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import take
from sim_backend.photography import Photographer
from sim_backend.ptpip.process import MODELS, Model
from sim_backend.scene import Scene

SCENE = "semi_ellipsoid"
PHOTO_S = 0.5
# An exposure of a quarter of that, as the rehearsal divides the time of a photo.
SHUTTER = {"generic": {"shutterspeed": "0.1250s"}, "canon-eos-40d": {"shutterspeed": "1/8"}}
TAG = {"column": 26, "row": 26, "cell_px": 3}
SWEPT_PX = (160, 320)
QUICK = {"still_after_move_s": 0.0, "still_after_fill_s": 0.0}
FAST_PUMP_ML_PER_MIN, FAST_STAGE_MM_PER_S = 9000.0, 10.0
SEEN_MARGIN_PX = 12


def rate(*, wire: bool, columns: int, step_px: float, folder: Path) -> dict[str, float]:
    """Capture four whole sets on the simulated clock."""
    options = SceneOptions(camera_columns=columns, display_columns=columns, step_px=step_px, width_px=2 * step_px)
    scene = open_scene(SCENE, options)
    config = config_of_scene(scene, options)
    with open_devices(config, simulation=Simulation(scene, wire=wire)) as devices:
        started_s = time.monotonic()
        result = capture(config, folder, devices=devices, scene=scene, resume=False, console=Console(quiet=True))
        elapsed_s = time.monotonic() - started_s
    within_s, count = within_sweeps(folder)
    return {
        "photos": result.photos_done,
        "whole_capture_s": round(elapsed_s, 2),
        "photos_per_s": round(result.photos_done / elapsed_s, 2),
        "photos_per_s_within_sweeps": round(count / within_s, 2),
    }


class WatchedClock:
    """The clock of the room; remembers when somebody slept on it, in the time of the journal, and how long."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.slept: list[tuple[float, float]] = []

    def now_s(self) -> float:
        return self._clock.now_s()

    def sleep_s(self, duration_s: float) -> None:
        if duration_s > 0:
            self.slept.append((time.time(), duration_s))
        self._clock.sleep_s(duration_s)


def overhead(model: Model, *, overlap: bool, columns: int, step_px: float, folder: Path) -> dict[str, Any]:
    """Capture four whole sets in real time, through the wire."""
    scene, config = tagged_rig(model, columns=columns, step_px=step_px, read=overlap)
    simulation = Simulation(scene, wire=True, real_time=True, camera_model=model)
    with open_devices(config, simulation=simulation) as opened:
        clock = WatchedClock(opened.clock)
        devices = replace(opened, clock=clock)
        capture(config, folder, devices=devices, scene=scene, resume=False, console=Console(quiet=True))
    sweeps = sweep_times_s(folder)
    within_s, count = within_sweeps(folder)
    settled_s = sum(
        duration_s for times_s in sweeps for at_s, duration_s in clock.slept if times_s[0] <= at_s <= times_s[-1]
    )
    gaps_s = [later - earlier for times_s in sweeps for earlier, later in pairwise(times_s)]
    return {
        "photos_timed": count,
        "within_sweeps_s": round(within_s, 2),
        "settle_waited_s": round(settled_s, 2),
        "camera_s": PHOTO_S * count,
        "overhead": round((within_s - settled_s) / (PHOTO_S * count), 3),
        "overhead_with_settling": round(within_s / (PHOTO_S * count), 3),
        "median_photo_s": round(statistics.median(gaps_s), 3),
        "slowest_photo_s": round(max(gaps_s), 3),
    }


def tagged_rig(model: Model, *, columns: int, step_px: float, read: bool) -> tuple[Scene, RigConfig]:
    """Return a rig whose camera sees the frame tag beside the object, in the part of the photos where it does."""
    options = SceneOptions(display_columns=512, camera_columns=columns, width_px=32.0, step_px=step_px)
    scene = open_scene(SCENE, options)
    data = config_of_scene(scene, options).model_dump()
    low_px, high_px = SWEPT_PX
    data["capture"]["swept"] = {
        "first_column_px": low_px,
        "last_column_px": high_px,
        "first_row_px": low_px,
        "last_row_px": high_px,
    }
    data["timing"] |= QUICK | {"photo_s": PHOTO_S}
    data["tank"]["pump_rate_ml_per_min"] = FAST_PUMP_ML_PER_MIN
    data["stage"]["velocity_mm_per_s"] = FAST_STAGE_MM_PER_S
    data["camera"]["settings"] = SHUTTER[model]
    data["live"] = {}
    data["frame_tag"] = TAG
    config = parse_config(data, source="bench")
    if read:
        data["frame_tag"] = TAG | {"seen_px": seen_px(scene, config)}
    return scene, parse_config(data, source="bench")


def seen_px(scene: Scene, config: RigConfig) -> tuple[float, float, float, float]:
    """Return the part of the photos that holds the tag in all four sets, as a person finds it with `rig display tag`."""
    photographer = Photographer(scene)
    corners = []
    for place in set_order(config):
        photo = next(photo for photo in all_photos(config) if photo.set_name == set_name(place))
        grey = simplejpeg.decode_jpeg(take(photo, place, photographer, config), colorspace="GRAY")[..., 0]
        found = find_tag(grey)
        assert found is not None, f"the tag is not seen in {photo.set_name}"
        corners.append(found.corners_px)
    everywhere = np.concatenate(corners)
    left, top = np.maximum(everywhere.min(axis=0) - SEEN_MARGIN_PX, 0)
    right, bottom = np.minimum(
        everywhere.max(axis=0) + SEEN_MARGIN_PX, [config.camera.columns - 1, config.camera.rows - 1]
    )
    return float(left), float(top), float(right), float(bottom)


def sweep_times_s(folder: Path) -> list[list[float]]:
    """Return for each sweep when its photos were recorded."""
    sweeps: dict[tuple[str, str], list[float]] = {}
    for record in read_photos(folder / "journal.jsonl"):
        if record.sweep in ("x", "y"):
            at_s = datetime.fromisoformat(record.time).timestamp()
            sweeps.setdefault((record.set, record.sweep), []).append(at_s)
    # A photo is recorded while the next one comes, but the last of a sweep at once: it would make the sweep look shorter.
    return [times_s[:-1] for times_s in sweeps.values()]


def within_sweeps(folder: Path) -> tuple[float, int]:
    """Return the time from the first photo of each sweep to its last but one, and how many were taken in it."""
    sweeps = sweep_times_s(folder)
    return sum(times_s[-1] - times_s[0] for times_s in sweeps), sum(len(times_s) - 1 for times_s in sweeps)


def main() -> None:
    """Measure; every capture goes to a folder of its own, which is removed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--columns", type=int, default=400, help="columns of the photos  [default: %(default)s]")
    parser.add_argument("--step-px", type=float, default=8.0, help="stripe step  [default: %(default)s]")
    parser.add_argument(
        "--models", nargs="*", choices=MODELS, default=MODELS, help="cameras whose overhead is measured"
    )
    parser.add_argument("--only", choices=("rate", "overhead"), help="measure one of the two")
    given = parser.parse_args()
    size = {"columns": given.columns, "step_px": given.step_px}
    found: dict[str, Any] = dict(size)
    with tempfile.TemporaryDirectory(prefix="capture-rate-") as scratch:
        if given.only != "overhead":
            simulated = rate(wire=False, **size, folder=Path(scratch) / "simulated")
            wire = rate(wire=True, **size, folder=Path(scratch) / "wire")
            ratio = wire["photos_per_s_within_sweeps"] / simulated["photos_per_s_within_sweeps"]
            found["rate"] = {"simulated": simulated, "wire": wire, "wire_over_simulated": round(ratio, 3)}
        if given.only != "rate":
            found["overhead"] = {
                model: {
                    name: overhead(model, overlap=overlap, **size, folder=Path(scratch) / f"{model}-{name}")
                    for name, overlap in (("overlap", True), ("strict", False))
                }
                for model in given.models
            }
    sys.stdout.write(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
