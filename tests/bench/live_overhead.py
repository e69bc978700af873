"""How much a capture is slowed by decoding each sweep while the next is photographed, and when the last one is ready.

    python -m tests.bench.live_overhead [--size 480] [--photo-s 0.2]

Two captures of the same scene in real time, without and with live decoding. Times are those of the journal: from the start of
a sweep to its last photo, all eight sweeps together.
"""

import argparse
import json
import tempfile
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from recon.sessions.journal import JOURNAL_NAME, read_journal
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import open_devices
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.scene import Scene


def run(config: RigConfig, scene: Scene, folder: Path) -> list[dict[str, Any]]:
    """Capture in real time and return the journal."""
    with open_devices(config, simulation=Simulation(scene, real_time=True)) as devices:
        capture(config, folder, devices=devices, scene=scene, resume=False, console=Console(quiet=True))
    return list(read_journal(folder / JOURNAL_NAME))


def sweeping_s(journal: list[dict[str, Any]]) -> float:
    """Return the seconds from the start of each sweep to its last photo, added up."""
    total = 0.0
    started: float | None = None
    last = 0.0
    for entry in journal:
        at = datetime.fromisoformat(entry["time"]).timestamp()
        if entry["event"] == "photo" and entry["sweep"] in ("x", "y"):
            last = at
        elif started is not None:
            total, started = total + last - started, None
        if entry["event"] == "sweep_started":
            started = last = at
    return total + (last - started if started is not None else 0.0)


def main() -> None:
    """Measure and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=480, help="columns of the photos")
    parser.add_argument(
        "--photo-s", type=float, default=0.2, help="seconds a photo takes, exposure and download together"
    )
    arguments = parser.parse_args()
    options = SceneOptions(camera_columns=arguments.size, display_columns=256, width_px=8, step_px=4)
    scene = open_scene("hemisphere", options)
    timing = {"photo_s": arguments.photo_s, "settle_s": 0.01, "still_after_move_s": 0.0, "still_after_fill_s": 0.0}
    found: dict[str, Any] = {"photo_px": arguments.size**2, "photo_s": arguments.photo_s}
    for name, live in (("without", False), ("with", True)):
        config = config_of_scene(scene, SceneOptions(**{**options_of(options), "live": live}))
        tank = config.tank.model_copy(update={"pump_rate_ml_per_min": 1e5}) if config.tank else None
        stage = config.stage.model_copy(update={"velocity_mm_per_s": 100.0})
        changes = {"timing": config.timing.model_copy(update=timing), "tank": tank, "stage": stage}
        with tempfile.TemporaryDirectory() as folder:
            journal = run(config.model_copy(update=changes), scene, Path(folder) / "session")
        found[f"sweeping_s_{name}"] = round(sweeping_s(journal), 2)
        judged = [entry for entry in journal if entry["event"] == "sweep_judged"]
        if judged:
            found["sweeps_judged"] = len(judged)
            found["last_sweep_ready_s_after_last_photo"] = judged[-1]["after_last_photo_s"]
    found["overhead"] = round(found["sweeping_s_with"] / found["sweeping_s_without"], 3)
    print(json.dumps(found, indent=2))


def options_of(options: SceneOptions) -> dict[str, Any]:
    """Return the options as a dictionary."""
    return {name: getattr(options, name) for name in SceneOptions.__slots__}


if __name__ == "__main__":
    main()
