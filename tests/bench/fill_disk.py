"""Fill the disk under captures and resume them: ``python -m tests.bench.fill_disk`` prints JSON.

The disk is a small tmpfs of its own (``unshare``, of util-linux, makes it without privileges), filled but for a random rest, so
that the system itself says ENOSPC: at a photo, at a line of the journal, at the manifest. Every second time room is made
while the capture is suspended, and it has to go on by itself.
"""

import argparse
import json
import os
import random
import subprocess
import sys
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console

import rig.capturing.disk_room
from recon.errors import SessionError
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import simulated_devices
from rig.planning.plan import all_photos
from rig.rehearsing.rehearsal import Simulation, open_world
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.photography import Photographer
from tests.bench._crash_judge import Judge, ShutterLog, good_photos

OPTIONS = SceneOptions(camera_columns=32, display_columns=32, step_px=4.0)
DISK_BYTES = 4_000_000
PAGE_BYTES = 4096
PROBES_BEFORE_ROOM = 3


class Bench:
    """The disk, what fills it, and the capture upon it."""

    def __init__(self, disk: Path, logs: Path) -> None:
        self.disk = disk
        self._ballast = disk / "ballast"
        self._logs = logs
        scene = open_scene("semi_ellipsoid", OPTIONS)
        config = config_of_scene(scene, OPTIONS)
        # The check before each photo would keep the capture from the end of the disk that it is to meet here.
        timing = config.timing.model_copy(update={"photo_mb": 0.0})
        self.config: RigConfig = config.model_copy(update={"timing": timing})
        self._scene = scene
        self._photographer = Photographer(scene)

    def leave(self, pages: int) -> None:
        """Fill the disk but for so many pages."""
        free_bytes = os.statvfs(self.disk).f_bavail * PAGE_BYTES
        self._ballast.write_bytes(bytes(free_bytes - pages * PAGE_BYTES))

    def make_room(self) -> None:
        """Take away what fills the disk."""
        self._ballast.unlink(missing_ok=True)

    def log(self, name: str) -> ShutterLog:
        """Return the shutter's log of a session."""
        return ShutterLog(self._logs / name)

    def run(self, name: str, *, room_when_suspended: bool = False) -> None:
        """Begin or resume a session."""
        session = self.disk / name
        resume = (session / "manifest.json").exists()
        with open_world(self.config, Simulation(self._scene)) as world, ExitStack() as stack:
            look, sleep_s = world.look, world.clock.sleep_s
            probes = 0

            def logged(**seen: Any) -> Any:
                sight = look(**seen)
                self.log(name).add(sight.frame_id, disturbed=sight.disturbed)
                return sight

            def room_comes(duration_s: float) -> None:
                nonlocal probes
                sleep_s(duration_s)
                probes += os.statvfs(self.disk).f_bavail == 0
                if room_when_suspended and probes == PROBES_BEFORE_ROOM:
                    self.make_room()

            watched: Any = world
            watched.look, watched.clock.sleep_s = logged, room_comes
            devices = simulated_devices(self.config, world, self._photographer)
            for device in (devices.camera, devices.display, devices.stage, devices.pump):
                if device is not None:
                    stack.enter_context(device)
            quiet = Console(quiet=True)
            capture(self.config, session, devices=devices, scene=self._scene, resume=resume, console=quiet)


def run_session(bench: Bench, judge: Judge, name: str, *, pages: int, by_itself: bool, met: Counter[str]) -> list[str]:
    """Let one capture meet the end of the disk; return what is wrong with its session afterwards."""
    session, log = bench.disk / name, bench.log(name)
    bench.leave(pages)
    faults, good = [], {}
    try:
        bench.run(name, room_when_suspended=by_itself)
        met["went on by itself"] += 1
    except SessionError as full:
        place = str(full).removeprefix(f"{session}/").partition("/")[0].partition(":")[0]
        met[f"ended at {place if place in ('photos', 'journal.jsonl') else 'the manifest'}"] += 1
        if "No space left on device" not in str(full) or "\n" in str(full):
            faults.append(f"said {full}")
        good = judge.releases_of_good(session, log)
        bench.make_room()
        bench.run(name)
    return faults + judge.faults(session, log, good)


def inside(disk: Path, *, sessions: int, seed: int) -> dict[str, object]:
    """Mount the disk, fill it, judge."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(disk)], check=True)
    rig.capturing.disk_room.DISK_RESERVE_BYTES = 0
    rng = random.Random(seed)
    met: Counter[str] = Counter()
    faults = {}
    with TemporaryDirectory(prefix="full-") as logs:
        bench = Bench(disk, Path(logs))
        before_pages = os.statvfs(disk).f_bavail
        bench.run("undisturbed")
        whole_pages = before_pages - os.statvfs(disk).f_bavail
        frames = {photo.key: photo.frame_id for photo in all_photos(bench.config)}
        photos = good_photos(disk / "undisturbed")
        judge = Judge({key: photos[key] for key in frames}, frames)
        subprocess.run(["rm", "-r", str(disk / "undisturbed")], check=True)
        for number in range(sessions):
            name = f"{number:04d}"
            pages = 0 if number % 10 == 0 else rng.randrange(1, whole_pages)
            found = run_session(bench, judge, name, pages=pages, by_itself=number % 2 == 1, met=met)
            if found:
                faults[number] = found
            bench.make_room()
            subprocess.run(["rm", "-r", str(disk / name)], check=True)
    return {
        "sessions": sessions,
        "pages_of_a_session": whole_pages,
        "photos_a_session": len(judge.expected),
        "how_they_met_the_end": dict(met.most_common()),
        "sessions_with_faults": faults,
    }


def main() -> None:
    """Fill, make room, judge; end with 1 if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--inside", type=Path, help="for its own use: where to mount the disk")
    given = parser.parse_args()
    if given.inside is None:
        with TemporaryDirectory(prefix="small-disk-") as disk:
            command = ["unshare", "--map-root-user", "--mount", sys.executable, "-m", "tests.bench.fill_disk"]
            raise SystemExit(subprocess.run([*command, *sys.argv[1:], "--inside", disk], check=False).returncode)
    result = inside(given.inside, sessions=given.sessions, seed=given.seed)
    sys.stdout.write(json.dumps(result, indent=2) + "\n")
    raise SystemExit(bool(result["sessions_with_faults"]))


if __name__ == "__main__":
    main()
