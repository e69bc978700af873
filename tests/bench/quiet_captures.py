"""How often a capture in which nothing moves is told that something did: short simulated captures with noise of their own.

``python -m tests.bench.quiet_captures [CAPTURES]`` prints, as JSON, the captures, the comparisons made and the alarms among
them, and how near the largest ones came. The photos' noise differs from photo to photo and from capture to capture.
"""

import json
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from recon.sessions.journal import JOURNAL_NAME, read_journal
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import simulated_devices
from rig.errors import SceneMovedError
from rig.rehearsing.rehearsal import Simulation, open_world
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.photography import Photographer
from sim_backend.scene import Scene

CAPTURES = 300
SCENES = ("hemisphere", "ornament", "semi_ellipsoid", "plate_round")
COLUMNS = 128
# A pump that fills in 20 s of the simulated clock is looked at 80 times, not 800.
PUMP_RATE_ML_PER_MIN = 12000.0
# More photos than one capture takes, so that no two captures share their noise.
PHOTOS_APART = 1000


@dataclass(slots=True)
class Count:
    """What all captures came to."""

    captures: int = 0
    comparisons: int = 0
    alarms: list[str] = field(default_factory=list)
    sigmas: list[float] = field(default_factory=list)
    shifts_px: list[float] = field(default_factory=list)
    spreads_px: list[float] = field(default_factory=list)
    lights: list[float] = field(default_factory=list)

    def add(self, folder: Path) -> None:
        """Add the comparisons that a session's journal tells of."""
        self.captures += 1
        for entry in read_journal(folder / JOURNAL_NAME):
            if entry["event"] != "scene_checked":
                continue
            self.comparisons += 1
            self.alarms += [finding["text"] for finding in entry["findings"]]
            for part in entry["parts"].values():
                self.sigmas.append(part["sigma"])
                self.shifts_px.append(float(np.hypot(*part["shift_px"])))
                self.spreads_px.append(part["spread_px"])
                self.lights.append(abs(part["light"]))


def short_rig(name: str, *, columns: int = COLUMNS) -> tuple[Scene, RigConfig]:
    """Return a scene with marks, and a watching rig that takes a few photos a sweep and waits as briefly as may be."""
    options = SceneOptions(camera_columns=columns, width_px=200.0, step_px=60.0, watch=True)
    scene = open_scene(name, options)
    config = config_of_scene(scene, options)
    brief = config.timing.model_copy(update={"still_after_move_s": 1.0, "still_after_fill_s": 1.0})
    tank = config.tank and config.tank.model_copy(update={"pump_rate_ml_per_min": PUMP_RATE_ML_PER_MIN})
    return scene, config.model_copy(update={"timing": brief, "tank": tank})


def count_alarms(captures: int, *, scenes: tuple[str, ...] = SCENES, columns: int = COLUMNS) -> Count:
    """Capture quiet scenes in turn and count what the watch said."""
    rigs = [
        (scene, config, Photographer(scene)) for scene, config in (short_rig(name, columns=columns) for name in scenes)
    ]
    count = Count()
    for number in range(captures):
        scene, config, photographer = rigs[number % len(rigs)]
        with tempfile.TemporaryDirectory() as place, open_world(config, Simulation(scene)) as world:
            world.unrest.renew_noise(first=1 + PHOTOS_APART * number)
            devices = simulated_devices(config, world, photographer)
            folder = Path(place) / "session"
            try:
                capture(config, folder, devices=devices, scene=scene, resume=False, console=Console(quiet=True))
            except SceneMovedError as error:
                count.alarms.append(str(error))
            count.add(folder)
    return count


def main() -> None:
    """Count and print."""
    count = count_alarms(int(sys.argv[1]) if len(sys.argv) > 1 else CAPTURES)
    print(
        json.dumps(
            {
                "captures": count.captures,
                "comparisons": count.comparisons,
                "parts_compared": len(count.sigmas),
                "alarms": len(count.alarms),
                "first_alarms": count.alarms[:3],
                "largest_shift_px": max(count.shifts_px),
                "largest_shift_sigma": max(count.sigmas),
                # Two components: their normalised length has a mean square of 2.
                "mean_square_sigma": float(np.mean(np.square(count.sigmas))),
                "largest_spread_px": max(count.spreads_px),
                "largest_light": max(count.lights),
            },
            indent=2,
        )
    )


if __name__ == "__main__":
    main()
