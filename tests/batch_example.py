"""Small simulated sessions for a batch, some of them broken, and a hand that kills the worker of one."""

import hashlib
import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from recon.batch.session_status import load_status
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session

# One object, and another one now and then, which stands apart in every metric of the group.
USUAL_SCENE, OTHER_SCENE = "semi_ellipsoid", "hemisphere"
OTHER_EVERY = 10
# What a run writes that holds neither times nor temporary names.
EQUAL_FILES = ("maps.npz", "cloud.ply", "mesh.ply", "mesh.glb", "manifest.json")


def simulate_one(folder: Path, *, scene_name: str, size: int, display_columns: int, seed: int) -> None:
    """Write a session of a scene, ``size`` photo pixels wide, with noise of its own."""
    options = SceneOptions(camera_columns=size, display_columns=display_columns, width_px=12.0, step_px=4.0, seed=seed)
    scene = open_scene(scene_name, options)
    simulate_session(scene, config_of_scene(scene, options), folder, workers=1, console=Console(quiet=True))


def make_sessions(folder: Path, *, good: int, size: int, display_columns: int) -> list[str]:
    """Write ``good`` sessions of two scenes, each with noise of its own, and two broken ones; return the good ones' names."""
    names = []
    for number in range(good):
        scene_name = OTHER_SCENE if number % OTHER_EVERY == 1 else USUAL_SCENE
        names.append(f"{number + 1:02d}-{scene_name}")
        simulate_one(
            folder / names[-1], scene_name=scene_name, size=size, display_columns=display_columns, seed=number + 1
        )
    shutil.copytree(folder / names[0], folder / "broken-manifest")
    text = (folder / "broken-manifest" / "manifest.json").read_text()
    (folder / "broken-manifest" / "manifest.json").write_text(text[: len(text) // 2])
    shutil.copytree(folder / names[0], folder / "lost-photo")
    (folder / "lost-photo" / "photos" / "pos0_air" / "x" / "0003.jpg").unlink()
    return names


@contextmanager
def killed_worker(results: Path, *, times: int = 1) -> Iterator[None]:
    """Kill the process that works on the session of these results, each time as soon as its status names it."""
    done = threading.Event()

    def watch() -> None:
        for attempt in range(1, times + 1):
            while not done.is_set():
                status = load_status(results)
                if status is not None and status.state == "running" and len(status.attempts) == attempt:
                    os.kill(status.attempts[-1].process, signal.SIGKILL)
                    break
                time.sleep(0.005)

    hand = threading.Thread(target=watch)
    hand.start()
    try:
        yield
    finally:
        done.set()
        hand.join()


def hashes(results: Path, files: Sequence[str] = EQUAL_FILES) -> dict[str, str]:
    """Return the hash of each file of one session's results."""
    return {file: hashlib.sha256((results / file).read_bytes()).hexdigest() for file in files}
