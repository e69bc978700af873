"""Kill captures at random instants and resume them: ``python -m tests.bench.kill_captures`` prints JSON.

Each capture is the command ``rig capture --sim`` in a process of its own, ended by SIGKILL: half of them by the room's clock, at
any instruction; half by the world's clock, so that fills and moves, which the simulated clock passes in no time, are hit as
often as in a lab. The tank and the stage outlive the process in their state file, where a pump under way runs on to its own
limit. Every third session is killed more than once, also while it is resumed.
"""

import argparse
import json
import os
import random
import signal
import sys
import time
import traceback
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NoReturn

import rig.devices
from recon.sessions.session import open_session
from rig.capturing.session_manifest import config_of_session
from rig.cli import main as rig_main
from rig.planning.plan import all_photos
from rig.rehearsing.scene_config import SceneOptions, open_scene
from sim_backend.clock import SimulatedClock
from sim_backend.photography import Photographer
from sim_backend.world import Sight, World
from sim_backend.world_file import load_state, save_state
from tests.bench._crash_judge import Judge, ShutterLog, good_photos, journal_lines

OPTIONS = SceneOptions(camera_columns=32, display_columns=32, step_px=4.0)
ARGUMENTS = ("--size", "32", "--display-columns", "32", "--step-px", "4")
SCENE = "semi_ellipsoid"
# How long the machine is gone: at once, within a fill, long after everything under way has ended.
LONGEST_GONE_S = 300.0
LONG_GONE_S = 1e5


@dataclass(frozen=True, slots=True)
class Bench:
    """What all captures share: the scene, traced once, and how long an undisturbed capture takes on both clocks."""

    photographer: Photographer
    judge: Judge
    room_s: float
    world_s: float


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """One session, and what outlives the programs that write it."""

    folder: Path
    options: tuple[str, ...] = ()

    @property
    def session(self) -> Path:
        """The session's folder."""
        return self.folder / "session"

    @property
    def state(self) -> Path:
        """The file of the simulated tank and stage."""
        return self.folder / "bench.json"

    @property
    def shutter(self) -> ShutterLog:
        """The releases of the simulated shutter."""
        return ShutterLog(self.folder / "shutter.log")

    def command(self) -> list[str]:
        """Return the command that an operator would type now."""
        begun = (self.session / "manifest.json").exists()
        how = ["--resume"] if begun else [*ARGUMENTS, *self.options]
        return ["rig", "capture", "--session", str(self.session), "--sim", "--state", str(self.state), *how]


def start(rehearsal: Rehearsal, photographer: Photographer, *, dies_after_s: float | None = None) -> int:
    """Begin or resume the capture in a process of its own and return its number; it may die by the world's clock."""
    process = os.fork()
    if process == 0:
        try:
            _be_the_capture(rehearsal, photographer, dies_after_s)
        except BaseException:  # whatever it is must not return into the parent's code
            traceback.print_exc()
        finally:
            os._exit(99)
    return process


def _be_the_capture(rehearsal: Rehearsal, photographer: Photographer, dies_after_s: float | None) -> NoReturn:
    out = os.open(rehearsal.folder / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(out, 1)
    os.dup2(out, 2)
    look, sleep = World.look, SimulatedClock.sleep_s
    slept_s = 0.0

    def logged(world: World, **seen: Any) -> Sight:
        sight = look(world, **seen)
        rehearsal.shutter.add(sight.frame_id, disturbed=sight.disturbed)
        return sight

    def mortal(clock: SimulatedClock, duration_s: float) -> None:
        nonlocal slept_s
        sleep(clock, duration_s)
        slept_s += max(duration_s, 0.0)
        if dies_after_s is not None and slept_s >= dies_after_s:
            os.kill(os.getpid(), signal.SIGKILL)

    patched: Any = rig.devices
    patched.Photographer = lambda scene: photographer  # noqa: ARG005  (traced before)
    World.look = logged  # type: ignore[method-assign]
    SimulatedClock.sleep_s = mortal  # type: ignore[method-assign]
    sys.argv = rehearsal.command()
    try:
        rig_main()
    except SystemExit as end:
        os._exit(int(end.code or 0))
    os._exit(0)


def ended(process: int) -> int:
    """Wait for a capture and return its exit code, negative for a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def prepare(rehearsal: Rehearsal) -> Bench:
    """Trace the scene and run the capture that nobody disturbs."""
    rehearsal.folder.mkdir()
    scene = open_scene(SCENE, replace(OPTIONS, watch="--watch" in rehearsal.options))
    photographer = Photographer(scene)
    for place_mm in scene.stage_positions_mm:
        for wet in (False, True):
            photographer.pixel_coordinates(stage_position_mm=place_mm, wet=wet)
    begun_s = time.monotonic()
    if ended(start(rehearsal, photographer)) != 0:
        raise SystemExit((rehearsal.folder / "said.txt").read_text(encoding="utf-8"))
    room_s = time.monotonic() - begun_s
    session = open_session(rehearsal.session)
    frames = {photo.key: photo.frame_id for photo in all_photos(config_of_session(session), session.ranges)}
    expected = {key: data for key, data in good_photos(rehearsal.session).items() if key in frames}
    releases = rehearsal.shutter.releases()
    if set(expected) != set(frames) or {releases[str(frame)] for frame in frames.values()} != {1}:
        raise SystemExit("the undisturbed capture is not whole")
    # In a scene that is watched, every photo has noise of its own, as a real one.
    judge = Judge(expected, frames, plain=(lambda _: b"") if "--watch" in rehearsal.options else (lambda data: data))
    return Bench(photographer, judge, room_s, load_state(rehearsal.state).at_s)


def kill_one(bench: Bench, rehearsal: Rehearsal, rng: random.Random, *, by_room: bool) -> bool:
    """Run the capture until it is killed; return False where it had ended before."""
    share = bench.judge.share_left(rehearsal.session)
    if by_room:
        process = start(rehearsal, bench.photographer)
        time.sleep(rng.uniform(0, bench.room_s * share))
        os.kill(process, signal.SIGKILL)
    else:
        process = start(rehearsal, bench.photographer, dies_after_s=rng.uniform(0, bench.world_s * share))
    return ended(process) == -signal.SIGKILL


def stay_away(rehearsal: Rehearsal, rng: random.Random) -> None:
    """Let the world's time pass while no program runs."""
    if rehearsal.state.exists():
        state = load_state(rehearsal.state)
        gone_s = rng.choice([0.0, rng.uniform(0, LONGEST_GONE_S), LONG_GONE_S])
        save_state(replace(state, at_s=state.at_s + gone_s), rehearsal.state)


def last_event(rehearsal: Rehearsal) -> str:
    """Return what the journal tells last: what was under way when the program died."""
    lines = journal_lines(rehearsal.session)
    return lines[-1]["event"] if lines else "nothing written"


def run_session(bench: Bench, rehearsal: Rehearsal, rng: random.Random, died_in: Counter[str]) -> list[str] | None:
    """Kill and resume one session; return its faults, or None where no kill hit it."""
    rehearsal.folder.mkdir()
    good: dict[Any, int] = {}
    kills = 0
    for _ in range(rng.choice([1, 1, 1, 1, 2, 3])):
        if not kill_one(bench, rehearsal, rng, by_room=rng.random() < 0.5):
            continue
        kills += 1
        died_in[last_event(rehearsal)] += 1
        # Counted when it was first found good: a release after that, in whatever run, is one too many.
        good = bench.judge.releases_of_good(rehearsal.session, rehearsal.shutter) | good
        stay_away(rehearsal, rng)
    if not kills:
        return None
    code = ended(start(rehearsal, bench.photographer))
    said = (rehearsal.folder / "said.txt").read_text(encoding="utf-8")
    faults = bench.judge.faults(rehearsal.session, rehearsal.shutter, good)
    world = load_state(rehearsal.state)
    if code != 0 or "Traceback" in said:
        faults.append(f"ended with {code}: {said[-500:]}")
    if world.overflow_ml or world.flow is not None:
        faults.append(f"the tank ran over by {world.overflow_ml} ml, or the pump still runs")
    return faults


def main() -> None:
    """Kill, resume, judge; end with 1 if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--option", action="append", default=[], help="of rig capture too, such as --option=--watch")
    given = parser.parse_args()
    options = tuple(given.option)
    rng = random.Random(given.seed)
    died_in: Counter[str] = Counter()
    faults: dict[int, list[str]] = {}
    sessions = in_vain = 0
    with TemporaryDirectory(prefix="killed-") as folder:
        bench = prepare(Rehearsal(Path(folder) / "undisturbed", options))
        number = 0
        while sessions < given.sessions:
            number += 1
            rehearsal = Rehearsal(Path(folder) / f"{number:04d}", options)
            found = run_session(bench, rehearsal, rng, died_in)
            if found is not None:
                sessions += 1
                in_vain += bench.judge.shot_in_vain(rehearsal.shutter)
            if found:
                faults[number] = found
    result = {
        "sessions": sessions,
        "kills": died_in.total(),
        "photos_a_session": len(bench.judge.expected),
        "photos_in_doubt_shot_again": in_vain,
        "last_event_before_the_kill": dict(died_in.most_common()),
        "sessions_with_faults": faults,
    }
    sys.stdout.write(json.dumps(result, indent=2) + "\n")
    raise SystemExit(bool(faults))


if __name__ == "__main__":
    main()
