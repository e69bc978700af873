"""Capture, pump by hand, fail, be killed and go on, at random: ``python -m tests.bench.random_captures`` prints JSON.

Each run is one rig over some of its days: up to five controllers, each a capture or a command by hand, on devices that fail with
a chance drawn for the run; two in five controllers are killed. The ledger and the session outlive them. In half of the runs the
reservoir holds far more than the tank has room for, so that nothing but the software keeps the tank from overflowing. The
judge is the simulated world (:mod:`tests.bench._random_rig`), never what the rig believes.
"""

import argparse
import json
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console

from drivers.errors import DeviceError
from recon.errors import ReconError
from recon.sessions.journal import JOURNAL_NAME
from rig.by_hand.pump_cli import _flow
from rig.capturing.capture import capture
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import CaptureStopped, RigError
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.tank.flow import check_level_after, learn_level
from rig.tank.ledger import LevelLearnt
from rig.tank.ledger_book import LedgerBook
from sim_backend.camera import SimulatedCamera
from sim_backend.display import SimulatedDisplay
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.scene import Scene
from sim_backend.stage import SimulatedStage
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.world import TankSize, WorldState
from tests.bench._random_rig import (
    RATE_ML_PER_MIN,
    Chance,
    FlatOptics,
    Hardware,
    Human,
    Killed,
    Life,
    Unreliable,
    WatchedWorld,
    cut,
)

OPTIONS = SceneOptions(camera_columns=32, display_columns=32, step_px=15.0)
FAULT_CHANCES = (0.0, 0.001, 0.005, 0.02)
MOST_CONTROLLERS = 5
KILLED_SHARE = 0.4
THERE_SHARE = 0.7
ACCIDENT_SHARE = 0.2
PLENTY_ML = 15_000.0
SHORT_OF_ROOM_ML = 500.0


@dataclass(frozen=True)
class Bench:
    """What all runs share."""

    config: RigConfig
    scene: Scene


@dataclass
class Tally:
    """What happened in many runs."""

    runs: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    violations: dict[int, list[str]] = field(default_factory=dict)

    def add(self, other: "Tally") -> None:
        """Take over another tally."""
        self.runs += other.runs
        self.counts += other.counts
        self.violations |= other.violations


def bench() -> Bench:
    """Return the small rig of all runs: 3 places a sweep, a pump that fills the tank in 20 s of its own time."""
    scene = open_scene("semi_ellipsoid", OPTIONS)
    config = config_of_scene(scene, OPTIONS)
    assert config.tank is not None
    timing = config.timing.model_copy(
        update={
            "still_after_fill_s": 1.0,
            "still_after_move_s": 0.5,
            "photo_s": 0.5,
            "longest_suspension_s": 20.0,
            "photo_mb": 0.001,
        }
    )
    tank = config.tank.model_copy(update={"pump_rate_ml_per_min": RATE_ML_PER_MIN})
    return Bench(config.model_copy(update={"timing": timing, "tank": tank}), scene)


class Run:
    """One rig from its first controller to its last."""

    def __init__(self, bench: Bench, seed: int, folder: Path) -> None:
        self.rng = rng = random.Random(seed)
        self.seed = seed
        self.counts: Counter[str] = Counter()
        self._bench = bench
        self._session = folder / "session"
        self._ledger = folder / "ledger.jsonl"
        config = bench.config
        assert config.tank is not None
        # A pump that is wrong and a reservoir that could flood the room are two faults, unless a sensor looks.
        board, self._sensor = rng.random() < 0.6, False
        if board:
            self._sensor = rng.random() < 0.6
        plenty = rng.random() < 0.5
        wrong_pump = rng.random() < 0.3 and (self._sensor or not plenty)
        in_tank_ml = rng.choice([0.0, 0.0, rng.uniform(0.0, 3000.0)])
        in_reservoir_ml = PLENTY_ML if plenty else config.tank.reservoir_ml - in_tank_ml
        holds_ml = in_reservoir_ml + SHORT_OF_ROOM_ML if plenty else config.tank.reservoir_ml
        self._config = config.model_copy(
            update={"tank": config.tank.model_copy(update={"reservoir_capacity_ml": holds_ml})}
        )
        self.life = Life()
        self.world = WatchedWorld(
            self.life,
            tank=TankSize(config.tank.free_volume_ml, config.tank.fill_ml),
            state=WorldState(tank_ml=in_tank_ml, reservoir_ml=in_reservoir_ml, stage_mm=3.0),
            reservoir_limit_ml=holds_ml,
        )
        self.world.faults.pump_factor = rng.uniform(0.8, 1.2) if wrong_pump else 1.0
        rate_ml_per_s = RATE_ML_PER_MIN / 60
        emulator = (
            TankBoardEmulator(
                self.world,
                fill_ml_per_s=rate_ml_per_s,
                drain_ml_per_s=rate_ml_per_s,
                full_at_ml=float("inf"),  # the float hangs: what keeps the tank from overflowing is above it
                counts_per_ml=0.1,
            )
            if board
            else NewEraEmulator(self.world, max_rate_ml_per_min=RATE_ML_PER_MIN)
        )
        self.hardware = Hardware(self.world, emulator, self._sensor)
        self._chance = Chance(rng, rng.choice(FAULT_CHANCES))
        book = LedgerBook(self._ledger, total_ml=config.tank.reservoir_ml)
        if plenty or rng.random() < 0.8:  # who fills a reservoir with more than the configuration says tells the rig
            book.note(LevelLearnt("tank", in_tank_ml, "told"))
            book.note(LevelLearnt("reservoir", in_reservoir_ml, "told"))
        self.counts["runs with software alone against the rim"] += plenty

    def run(self) -> None:
        """Let one controller after the other do what it does."""
        for _ in range(self.rng.randint(1, MOST_CONTROLLERS)):
            self._one_controller()
            self.world.check_liquid()
            self.world.clock.sleep_s(self.rng.choice([0.0, 2.0, 600.0]))
        self.world.check_liquid()

    def _one_controller(self) -> None:
        rng, clock = self.rng, self.world.clock
        self.life.dead = False
        self.life.steps_left = self.life.dies_at_s = None
        lengths: dict[Path, int | None] = {}
        kept = (self._ledger, self._session / JOURNAL_NAME)
        self.life.on_death = lambda: lengths.update(
            {path: path.stat().st_size if path.exists() else None for path in kept}
        )
        if rng.random() < KILLED_SHARE:
            if rng.random() < 0.5:
                self.life.steps_left = int(10 ** rng.uniform(0, 3.5))
            else:
                self.life.dies_at_s = clock.now_s() + 10 ** rng.uniform(-1, 2)
        self.hardware.mend()
        self.counts["controllers"] += 1
        failed = False
        try:
            with self._devices() as devices:
                self._work(devices)
        except Killed:
            failed = True
        except (RigError, ReconError, DeviceError, CaptureStopped) as told:
            failed = True
            self.counts["ended with a sentence"] += 1
            if "\n" in str(told):
                self.world.violations.append(f"more than a sentence: {told}")
        if self.life.dead:
            failed = True
            self.counts["killed"] += 1
            for path, length in lengths.items():
                cut(path, length)
        self._nobody_is_alive(at_once=not failed)

    def _nobody_is_alive(self, *, at_once: bool) -> None:
        """Check that the pump stands: at once after a controller that left in peace, else when its own timer is over."""
        self.life.dead = False
        self.life.steps_left = self.life.dies_at_s = None
        if not at_once:
            self.world.clock.sleep_s(self.hardware.dead_man_s + 0.01)
        if self.world.flow_direction() is not None:
            self.world.violations.append("the pump runs with nobody alive")

    @contextmanager
    def _devices(self) -> Iterator[Devices]:
        config, world, chance = self._config, self.world, self._chance
        assert config.tank is not None
        pump = self.hardware.driver(chance)
        exposure_s = 0.25 * config.timing.photo_s
        camera = SimulatedCamera(
            world, FlatOptics(), exposure_s=exposure_s, download_s=config.timing.photo_s - exposure_s
        )
        display = SimulatedDisplay(world, columns=config.display.columns, rows=config.display.rows, latency_s=0.03)
        stage = SimulatedStage(
            world, travel_mm=config.stage.travel_mm, velocity_mm_per_s=config.stage.velocity_mm_per_s
        )
        book = LedgerBook(self._ledger, total_ml=config.tank.reservoir_ml)
        parts: list[Any] = [Unreliable(device, world, chance) for device in (camera, display, stage)]
        with ExitStack() as stack:
            for device in (*parts, pump):
                stack.enter_context(device)
            operator = Human(world, there=self.rng.random() < THERE_SHARE, mend=self.hardware.mend)
            sensor = pump if self._sensor else None
            yield Devices(*parts, pump, sensor, operator, world.clock, book)  # type: ignore[arg-type]

    def _work(self, devices: Devices) -> None:
        """Do one of the things that people do with a rig."""
        rng, config = self.rng, self._config
        assert config.tank is not None
        if rng.random() < ACCIDENT_SHARE:
            self._let_something_happen(devices)
        most_ml = 1.2 * config.tank.free_volume_ml
        match rng.choice(["capture", "capture", "capture", "fill", "drain", "fill to", "drain to", "tell"]):
            case "capture":
                self._capture(devices)
            case ("fill" | "drain") as direction:
                moved_ml = _flow(config, devices, direction, volume_ml=rng.uniform(1.0, most_ml))
                check_level_after(devices, config, moved_ml=moved_ml)
            case "fill to":
                moved_ml = _flow(config, devices, "fill", to_ml=rng.uniform(0.0, most_ml))
                check_level_after(devices, config, moved_ml=moved_ml)
            case "drain to":
                moved_ml = _flow(config, devices, "drain", to_ml=rng.uniform(0.0, most_ml))
                check_level_after(devices, config, moved_ml=moved_ml)
            case _:
                state = self.world.state()
                devices.book.note(LevelLearnt("tank", state.tank_ml, "told"))
                devices.book.note(LevelLearnt("reservoir", state.reservoir_ml, "told"))
                learn_level(devices, config)
        self.counts["commands that did what they were asked"] += 1

    def _let_something_happen(self, devices: Devices) -> None:
        """Let an accident happen at one of the next looks at the pump."""
        pump: Any = devices.pump
        status, looks = pump.status, iter(range(self.rng.randint(0, 120), -1, -1))

        def struck() -> Any:
            if next(looks, -1) == 0:
                self.counts["accidents"] += 1
                self.hardware.accident(self.rng)
            return status()

        pump.status = struck

    def _capture(self, devices: Devices) -> None:
        journal = self._session / JOURNAL_NAME
        begun = journal.exists() and journal.stat().st_size > 0
        human: Any = devices.operator
        checked = begun and human.there
        if not begun and self._session.exists():
            self._session = self._session.with_name(self._session.name + "x")
        result = capture(
            self._config,
            self._session,
            devices=devices,
            scene=self._bench.scene,
            resume=begun,
            console=Console(quiet=True),
            person=human if human.there else None,
            checked=checked,
        )
        self.counts["whole captures"] += 1
        if result.photos_done != result.photos_needed:
            self.world.violations.append("a capture ended without all its photos")
        self._session = self._session.with_name(self._session.name + "x")


def one_run(bench: Bench, seed: int) -> Tally:
    """Run one rig and judge it."""
    shared_memory = Path("/dev/shm")
    with TemporaryDirectory(dir=shared_memory if shared_memory.is_dir() else None) as folder:
        run = Run(bench, seed, Path(folder))
        run.run()
    run.counts["photos"] += run.world.photos
    run.counts["flows"] += run.hardware.starts
    violations = list(dict.fromkeys(run.world.violations))
    return Tally(1, run.counts, {seed: violations} if violations else {})


def many_runs(seeds: range) -> Tally:
    """Run many rigs, one after the other."""
    tally, shared = Tally(), bench()
    for seed in seeds:
        tally.add(one_run(shared, seed))
    return tally


def main() -> int:
    """Print how many runs there were and what was violated; the status is 1 if anything was."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="of the first run; the others follow")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    begun_s = time.perf_counter()
    portions = [range(k, k + 100) for k in range(options.seed, options.seed + options.runs, 100)]
    portions = [range(p.start, min(p.stop, options.seed + options.runs)) for p in portions]
    tally = Tally()
    with ProcessPoolExecutor(options.workers) as pool:
        for part in pool.map(many_runs, portions):
            tally.add(part)
    print(
        json.dumps(
            {
                "runs": tally.runs,
                "runs_with_violations": len(tally.violations),
                **{name.replace(" ", "_"): count for name, count in sorted(tally.counts.items())},
                "violations": {str(seed): told for seed, told in sorted(tally.violations.items())[:20]},
                "seconds": round(time.perf_counter() - begun_s, 1),
            },
            indent=2,
        )
    )
    return 1 if tally.violations else 0


if __name__ == "__main__":
    sys.exit(main())
