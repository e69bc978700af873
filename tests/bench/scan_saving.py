"""What the scan saves, and what it costs the result: ``python -m tests.bench.scan_saving`` prints JSON.

Each scene is photographed twice, swept over the whole display and over what a scan found, and both are reconstructed.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console

from recon.maps import Maps
from recon.run import decode_session
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.session import TRUTH_NAME, open_session
from rig.capturing.capture import capture
from rig.devices import open_devices
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session

# Name, columns of the display, width and step of the stripe: the paper's sweeps are as fine as the last.
SCENES = (("hemisphere", 512, 8.0, 2.0), ("ornament", 512, 8.0, 2.0), ("semi_ellipsoid", 256, 6.0, 1.0))


def maps_of_session(folder: Path) -> tuple[Maps, int]:
    """Reconstruct a session; return its maps and its number of photos."""
    session = open_session(folder)
    return reconstruct(session, decode_session(session, Settings()), Settings()).maps, len(session.photos)


def measure(name: str, display_columns: int, width_px: float, step_px: float, *, size: int) -> dict[str, object]:
    """Compare the two ways for one scene."""
    size_options = {
        "camera_columns": size,
        "display_columns": display_columns,
        "width_px": width_px,
        "step_px": step_px,
    }
    whole, scanned = SceneOptions(**size_options), SceneOptions(**size_options, scan=True)
    scene = open_scene(name, whole)
    quiet = Console(quiet=True)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        simulate_session(scene, config_of_scene(scene, whole), folder / "whole", workers=2, console=quiet)
        config = config_of_scene(scene, scanned)
        with open_devices(config, simulation=Simulation(scene)) as devices:
            capture(config, folder / "part", devices=devices, scene=scene, resume=False, console=quiet)
        full, photos_full = maps_of_session(folder / "whole")
        part, photos_part = maps_of_session(folder / "part")
        with np.load(folder / "whole" / TRUTH_NAME) as truth:
            point_mm = truth["point_mm"]
    on_object = np.isfinite(point_mm).all(axis=2)
    both = full.valid() & part.valid() & on_object
    apart_mm = np.linalg.norm(full.point_mm[both] - part.point_mm[both], axis=1)
    found: dict[str, object] = {"scene": name, "photos_whole": photos_full, "photos_scanned": photos_part}
    for way, maps in (("whole", full), ("scanned", part)):
        fine = maps.valid() & on_object
        error_mm = np.linalg.norm(maps.point_mm[fine] - point_mm[fine], axis=1)
        found[f"complete_{way}"] = round(float(fine.sum() / on_object.sum()), 5)
        found[f"rms_error_mm_{way}"] = float(f"{np.sqrt((error_mm**2).mean()):.4g}")
    found["apart_in_own_sd_median"] = float(f"{np.median(apart_mm / full.sd_mm[both]):.2g}")
    return found


def main() -> None:
    """Measure every scene and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=240, help="columns of the photos")
    size = parser.parse_args().size
    print(json.dumps([measure(*scene, size=size) for scene in SCENES], indent=2))


if __name__ == "__main__":
    main()
