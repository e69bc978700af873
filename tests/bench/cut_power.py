"""Cut the power of captures at random points and resume them: ``python -m tests.bench.cut_power`` prints JSON.

Every file operation of a capture is recorded, with the tank, the stage and the shutter as they were at that moment. A cut takes
the record up to a random operation and keeps of it only what was flushed, and of the rest a random part (``_power_cut``): then
the session is resumed on a rig whose pump stopped and whose stage has forgotten its place. Some sessions lose their power again
while they are resumed; some are killed first, so that what was written and not flushed is seen by the next program and only
then lost. ``--without flush`` shows what would be lost if files were not flushed, ``--without flush_folder`` if their names were
not.
"""

import argparse
import json
import random
import sys
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console

import recon.sessions.session
from recon.errors import SessionError
from recon.sessions.session import SessionWriter
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import simulated_devices
from rig.planning.plan import all_photos
from rig.rehearsing.rehearsal import Simulation, fresh_state, open_world
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.photography import Photographer
from sim_backend.scene import Scene
from sim_backend.world import WorldState
from sim_backend.world_file import save_state
from tests.bench._crash_judge import Judge, PhotoKey, ShutterLog, good_photos
from tests.bench._power_cut import DiskModel, Operation, RecordingDisk, tree_of, write_tree

OPTIONS = SceneOptions(camera_columns=32, display_columns=32, step_px=4.0)


@dataclass(frozen=True, slots=True)
class Moment:
    """The rig just before an operation: what lasts of it, how often the shutter was released, what was acknowledged."""

    world: WorldState
    releases: int
    acknowledged: frozenset[PhotoKey]


@dataclass(slots=True)
class Record:
    """One run of a capture: its operations, the moment before each, and the moment when it ended."""

    operations: list[Operation] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Bench:
    """What all runs share."""

    config: RigConfig
    scene: Scene
    photographer: Photographer
    without: str


def record_capture(bench: Bench, root: Path, world_state: WorldState, shutter: list[str]) -> Record:
    """Begin or resume the session in ``root`` and run it to its end; ``shutter`` is the log so far, and grows."""
    record = Record()
    acknowledged: set[PhotoKey] = set()
    save_photo = SessionWriter.save_photo
    state_file = root.parent / f"{root.name}.json"
    save_state(world_state, state_file)
    with open_world(bench.config, Simulation(bench.scene, state_file=state_file)) as world, ExitStack() as stack:
        look = world.look

        def logged(**seen: Any) -> Any:
            sight = look(**seen)
            shutter.append(f"{sight.frame_id} {int(sight.disturbed)}")
            return sight

        def remembered(writer: SessionWriter, data: bytes, **fields: Any) -> Any:
            photo = save_photo(writer, data, **fields)
            acknowledged.add((photo.set, photo.sweep, photo.index))
            return photo

        def moment() -> None:
            record.moments.append(Moment(world.state(), len(shutter), frozenset(acknowledged)))

        watched: Any = world
        watched.look = logged
        disk = RecordingDisk(root, moment, forgotten=bench.without)
        devices = simulated_devices(bench.config, world, bench.photographer)
        for device in (devices.camera, devices.display, devices.stage, devices.pump, devices.level_sensor):
            if device is not None:
                stack.enter_context(device)
        recon.sessions.session.DISK = disk
        SessionWriter.save_photo = remembered  # type: ignore[method-assign]
        try:
            session = root / "session"
            resume = (session / "manifest.json").exists()
            quiet = Console(quiet=True)
            capture(bench.config, session, devices=devices, scene=bench.scene, resume=resume, console=quiet)
        finally:
            SessionWriter.save_photo = save_photo  # type: ignore[method-assign]
            recon.sessions.session.DISK = recon.sessions.session.Disk()
        moment()
    record.operations = disk.operations
    return record


def after_the_cut(moment: Moment) -> WorldState:
    """Return a rig whose power is back: nothing moves, and the stage does not know where it stands."""
    return replace(moment.world, flow=None, motion=None, stage_homed=False)


class Session:
    """One session on its way through kills and cuts."""

    def __init__(self, bench: Bench, judge: Judge, folder: Path, begun: Record) -> None:
        self._bench = bench
        self._judge = judge
        self._folder = folder
        self._shutter: list[str] = []
        self._good: dict[PhotoKey, int] = {}
        self._acknowledged: frozenset[PhotoKey] = frozenset()
        self._runs = 0
        self._model, self._record = DiskModel({}), begun
        self.faults: list[str] = []

    def end_by_force(self, rng: random.Random, *, cut: bool, shutter: list[str]) -> str:
        """End the run that is recorded at a random operation, resume the session, and return what the operation was."""
        number = rng.randrange(len(self._record.operations))
        model = self._model.after(self._record.operations[:number])
        moment = self._record.moments[number]
        if cut:
            tree = model.after_power_cut(rng)
            model, world = DiskModel(tree), after_the_cut(moment)
        else:
            tree, world = model.seen(), moment.world
        root = self._folder / f"{self._runs}"
        self._runs += 1
        write_tree(tree, root)
        self._shutter = shutter[: moment.releases]
        self._compare(root, moment)
        at = self._record.operations[number].kind
        self._model = model
        try:
            self._record = record_capture(self._bench, root, world, self._shutter)
        except SessionError as lost:
            self.faults.append(f"cannot be resumed: {lost}")
            return at
        if tree_of(root) != model.after(self._record.operations).seen():
            self.faults.append("the record does not tell all that was done to the files")
        return at

    def _log(self) -> ShutterLog:
        log = ShutterLog(self._folder / "shutter.log")
        log.path.write_text("".join(f"{line}\n" for line in self._shutter), encoding="ascii")
        return log

    def _compare(self, root: Path, moment: Moment) -> None:
        """Look at what is left before anything resumes: what was acknowledged must be good, and its count is taken."""
        good = self._judge.releases_of_good(root / "session", self._log())
        self._acknowledged |= moment.acknowledged
        self.faults += [f"{key} had been acknowledged, and is lost" for key in self._acknowledged - good.keys()]
        self._good = {key: self._good.get(key, count) for key, count in good.items()}

    def verdict(self) -> list[str]:
        """Return what is wrong with the session after its last run."""
        if self.faults:
            return self.faults
        root = self._folder / f"{self._runs - 1}"
        world = self._record.moments[-1].world
        self.faults += self._judge.faults(root / "session", self._log(), self._good)
        if world.overflow_ml or world.flow is not None:
            self.faults.append(f"the tank ran over by {world.overflow_ml} ml, or the pump still runs")
        return self.faults

    @property
    def shutter(self) -> list[str]:
        """The releases so far."""
        return self._shutter

    def shot_in_vain(self) -> int:
        """Return how many releases went into photos that had to be taken again."""
        return self._judge.shot_in_vain(self._log())


def main() -> None:
    """Cut, resume, judge; end with 1 if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--without", choices=("flush", "flush_folder"), default="", help="what to leave out")
    given = parser.parse_args()
    rng = random.Random(given.seed)
    scene = open_scene("semi_ellipsoid", OPTIONS)
    config = config_of_scene(scene, OPTIONS)
    bench = Bench(config, scene, Photographer(scene), given.without)
    cut_at: Counter[str] = Counter()
    kills = in_vain = 0
    faults: dict[int, list[str]] = {}
    with TemporaryDirectory(prefix="cut-") as folder:
        undisturbed = Path(folder) / "undisturbed"
        undisturbed.mkdir()
        shutter: list[str] = []
        begun = record_capture(bench, undisturbed, fresh_state(config), shutter)
        frames = {photo.key: photo.frame_id for photo in all_photos(config)}
        photos = good_photos(undisturbed / "session")
        judge = Judge({key: data for key, data in photos.items() if key in frames}, frames)
        for number in range(given.sessions):
            home = Path(folder) / f"{number:04d}"
            home.mkdir()
            session = Session(bench, judge, home, begun)
            log = shutter
            for cut in rng.choice([(True,), (True,), (True, True), (False, True), (False, False, True)]):
                if session.faults:
                    break
                at = session.end_by_force(rng, cut=cut, shutter=log)
                log = session.shutter
                if cut:
                    cut_at[at] += 1
                else:
                    kills += 1
            in_vain += session.shot_in_vain()
            if found := session.verdict():
                faults[number] = found
    result = {
        "sessions": given.sessions,
        "power_cuts": cut_at.total(),
        "kills_before": kills,
        "operations_of_an_undisturbed_capture": len(begun.operations),
        "photos_a_session": len(judge.expected),
        "photos_in_doubt_shot_again": in_vain,
        "next_operation_at_the_cut": dict(cut_at.most_common()),
        "sessions_with_faults": faults,
    }
    sys.stdout.write(json.dumps(result, indent=2) + "\n")
    raise SystemExit(bool(faults))


if __name__ == "__main__":
    main()
