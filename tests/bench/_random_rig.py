"""A rig in simulated time whose devices fail at random, and a world that watches it: the machinery of random captures.

The pumps are the real drivers, joined to their emulators without a wire, so that a lost reply costs simulated time only. Camera,
display and stage are simulated, the optics a constant picture. A controller that is killed does nothing any more, neither in its
``finally`` nor on the disk; what goes on is what the world and the pump's own timer do. The checks look at the world and never at
what the rig believes.
"""

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg

from drivers.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
)
from drivers.new_era_pump import NewEraPump
from drivers.protocols import FlowDirection, Frame
from drivers.tank_board import TankBoard
from rig.errors import CaptureError
from sim_backend.clock import SimulatedClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.world import TankSize, World, WorldState

# The fastest round rate that a New Era pump takes: time is dear in ten thousand runs.
RATE_ML_PER_MIN = 9600.0
LOST_REPLY_S = 0.3
BOARD_DEAD_MAN_S, NEW_ERA_DEAD_MAN_S = 1.0, 5
PICTURE = simplejpeg.encode_jpeg(np.full((32, 32, 1), 40, np.uint8), colorspace="GRAY")
ERRORS = (DeviceTimeoutError, DeviceBusyError, DeviceProtocolError, DeviceNotFoundError)


class Killed(BaseException):
    """The controller is dead; whatever it still tries to do raises this again."""


@dataclass
class Life:
    """Whether the controller is alive, and when it dies: after so many steps, or at a moment of the world's clock."""

    dead: bool = False
    steps_left: int | None = None
    dies_at_s: float | None = None
    on_death: Callable[[], None] = lambda: None

    def step(self) -> None:
        """One thing that the controller does."""
        if not self.dead and self.steps_left is not None:
            self.steps_left -= 1
            if self.steps_left <= 0:
                self.end()
        if self.dead:
            raise Killed

    def end(self) -> None:
        """Die."""
        self.dead = True
        self.on_death()


class MortalClock(SimulatedClock):
    """A clock on which a controller may die while it sleeps."""

    def __init__(self, life: Life) -> None:
        super().__init__()
        self._life = life

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass, up to the controller's end."""
        life = self._life
        if life.dead:
            raise Killed
        if life.dies_at_s is not None and self.now_s() + duration_s >= life.dies_at_s:
            super().sleep_s(max(0.0, life.dies_at_s - self.now_s()))
            life.end()
            raise Killed
        super().sleep_s(duration_s)


class WatchedWorld(World):
    """The world, with somebody who notes in ``violations`` what must never happen. Dead hands move nothing in it."""

    def __init__(self, life: Life, *, tank: TankSize, state: WorldState, reservoir_limit_ml: float) -> None:
        dark = Frame(axis="x", levels=np.zeros(32, np.uint8))
        super().__init__(clock=MortalClock(life), tank=tank, dark_frame=dark, state=state)
        self.life = life
        self.violations: list[str] = []
        self.exposing = False
        self.photos = 0
        self._reservoir_limit_ml = reservoir_limit_ml

    def _must_not(self, what: str, *, moves: bool = False, pumps: bool = False, exposes: bool = False) -> None:
        for happens, during in (
            (moves and self.is_moving(), "the stage moves"),
            (pumps and self.flow_direction() is not None, "the pump runs"),
            (exposes and self.exposing, "a photo is exposed"),
        ):
            if happens:
                self.violations.append(f"{what} while {during}")

    def start_flow(self, direction: FlowDirection, *, rate_ml_per_s: float, volume_ml: float, max_run_s: float) -> None:
        """Watch, then pump."""
        self._must_not("the pump is started", moves=True, exposes=True)
        super().start_flow(direction, rate_ml_per_s=rate_ml_per_s, volume_ml=volume_ml, max_run_s=max_run_s)

    def start_motion(self, to_mm: float, *, velocity_mm_per_s: float) -> None:
        """Watch, then move."""
        if not self.life.dead:
            self._must_not("the stage is started", pumps=True, exposes=True)
            super().start_motion(to_mm, velocity_mm_per_s=velocity_mm_per_s)

    def stop_motion(self) -> None:
        """Stop, unless the hand is dead."""
        if not self.life.dead:
            super().stop_motion()

    def stop_flow(self) -> None:
        """Stop, unless the hand is dead."""
        if not self.life.dead:
            super().stop_flow()

    def show(self, frame: Frame, *, frame_id: int | None, **settings: float) -> None:
        """Watch, then show."""
        if not self.life.dead:
            self._must_not("another frame is shown", exposes=True)
            super().show(frame, frame_id=frame_id, **settings)

    @contextmanager
    def exposure(self) -> Iterator[None]:
        """The time in which a shutter is open."""
        self._must_not("the shutter opens", moves=True, pumps=True)
        self.exposing = True
        try:
            yield
            self._must_not("the shutter closes", moves=True, pumps=True)
            self.photos += 1
        finally:
            self.exposing = False

    def check_liquid(self) -> None:
        """Look at rim and reservoir."""
        state = self.state()
        if state.overflow_ml > 0:
            self.violations.append(f"{state.overflow_ml:.1f} ml ran over the tank's rim")
        if state.reservoir_ml > self._reservoir_limit_ml + 1.0:
            self.violations.append(f"{state.reservoir_ml:.0f} ml in the reservoir")


@dataclass
class Chance:
    """How often something fails."""

    rng: random.Random
    fault: float

    def strikes(self) -> bool:
        """Tell whether it fails now."""
        return self.rng.random() < self.fault


class DirectPort:
    """What a driver asks of its serial port, answered by an emulator at once; faults lose bytes, or the port vanishes."""

    address = "in-process"

    def __init__(self, emulator: NewEraEmulator | TankBoardEmulator, world: WatchedWorld, chance: Chance) -> None:
        self.is_open = False
        self._emulator = emulator
        self._world = world
        self._chance = chance
        self._heard = bytearray()
        self._vanished = False

    def open(self) -> None:
        """Open it; one that vanished is plugged in again by whoever starts the next program."""
        self._step()
        self.is_open = True

    def close(self) -> None:
        """Close it."""
        self.is_open = False
        self._heard.clear()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """One question and its answer."""
        yield

    def _step(self) -> None:
        self._world.life.step()
        if self._chance.fault and self._chance.rng.random() < self._chance.fault / 20:
            self._vanished = True
        if self._vanished:
            raise DeviceNotFoundError("pump: its port vanished; plug it in again")

    def write(self, data: bytes) -> None:
        """Hand it to the emulator, or lose it on the way in, or lose the answer."""
        self._step()
        if self._chance.strikes():  # never arrives
            return
        answer = self._emulator.receive(data)
        if not self._chance.strikes():
            self._heard += answer

    def flush_input(self) -> bytes:
        """Throw away what was heard."""
        self._heard += self._emulator.poll()
        heard, self._heard = bytes(self._heard), bytearray()
        return heard

    def resynchronise(self, *, quiet_s: float, deadline_s: float) -> bytes:  # noqa: ARG002  (simulated time)
        """Wait a moment, then throw away what was heard."""
        self._world.clock.sleep_s(quiet_s)
        return self.flush_input()

    def read_until(self, terminator: bytes, *, deadline_s: float, question: str = "") -> bytes:  # noqa: ARG002
        """Return what was heard up to ``terminator``."""
        return self._take(self._heard.find(terminator) + 1, question)

    def read_exact(self, count: int, *, deadline_s: float, question: str = "") -> bytes:  # noqa: ARG002
        """Return ``count`` bytes."""
        return self._take(count if len(self._heard) >= count else 0, question)

    def _take(self, count: int, question: str) -> bytes:
        self._world.life.step()
        if count == 0:
            self._world.clock.sleep_s(LOST_REPLY_S)
            raise DeviceTimeoutError(f"pump: nothing came for {question}")
        taken = bytes(self._heard[:count])
        del self._heard[:count]
        return taken


class Unreliable:
    """A device of which every call may fail, before it does anything or after it has done it."""

    def __init__(self, device: Any, world: WatchedWorld, chance: Chance) -> None:
        self._device = device
        self._world = world
        self._chance = chance

    def __enter__(self) -> "Unreliable":
        self._device.__enter__()
        return self

    def __exit__(self, *reason: Any) -> None:
        self._device.__exit__(*reason)

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._device, name)

        def call(*args: Any, **settings: Any) -> Any:
            self._world.life.step()
            if name != "info" and self._chance.strikes():
                raise self._error(name)
            if name == "expose":
                with self._world.exposure():
                    result = method(*args, **settings)
            else:
                result = method(*args, **settings)
            if name != "info" and self._chance.strikes():
                raise self._error(name)
            return result

        return call

    def _error(self, name: str) -> DeviceError:
        return self._chance.rng.choice(ERRORS)(f"{name}: failed by chance")


class FlatOptics:
    """Stands in for the optics: the same picture whatever is shown."""

    def photograph(self, *_args: Any, **_settings: Any) -> bytes:
        """Return the picture."""
        return PICTURE


@dataclass
class Human:
    """Operator and person in one: answers with the truth, or is not there. Whoever has looked has mended the hardware."""

    world: WatchedWorld
    there: bool
    mend: Callable[[], None] = field(default=lambda: None)
    patience: int = 10

    def do(self, request: str, text: str) -> None:  # noqa: ARG002
        """Nothing is asked of the hands of a rig with a pump."""
        raise CaptureError("nobody is at this terminal")

    def tank_ml(self, *, fill_ml: float) -> float:  # noqa: ARG002
        """Look at the tank."""
        if not self.there:
            raise CaptureError("a person has to answer, but nobody is at this terminal")
        return self.world.state().tank_ml

    def after_pause(self, text: str, *, idle: Callable[[], None]) -> str:  # noqa: ARG002
        """Go on."""
        return "go_on"

    def has_looked(self, text: str, *, idle: Callable[[], None]) -> bool:  # noqa: ARG002
        """Mend it, or give up when that has not helped: a floor that stays wet keeps the leak contact open."""
        self.mend()
        self.patience -= 1
        return self.patience > 0


@dataclass
class Hardware:
    """What outlives every controller: the world, and the pump's own electronics with what can happen to them."""

    world: WatchedWorld
    emulator: NewEraEmulator | TankBoardEmulator
    has_sensor: bool

    @property
    def dead_man_s(self) -> float:
        """How long the pump may run with nobody alive."""
        return BOARD_DEAD_MAN_S if isinstance(self.emulator, TankBoardEmulator) else NEW_ERA_DEAD_MAN_S

    @property
    def starts(self) -> int:
        """How often the pump was told to start."""
        if isinstance(self.emulator, TankBoardEmulator):
            return sum(line.startswith(("FILL", "DRAIN")) for line in self.emulator.lines)
        return sum(command.startswith("RUN") for command in self.emulator.commands)

    def driver(self, chance: Chance) -> TankBoard | NewEraPump:
        """Return the real driver on this hardware."""
        pump: TankBoard | NewEraPump
        port: Any = DirectPort(self.emulator, self.world, chance)
        if isinstance(self.emulator, TankBoardEmulator):
            points = [(0, 0.0), (1000, 10_000.0)] if self.has_sensor else []
            rates = {"fill_ml_per_min": RATE_ML_PER_MIN, "drain_ml_per_min": RATE_ML_PER_MIN}
            pump = TankBoard("in-process", **rates, level_points=points, kind="emulated")
            pump._port = port
        else:
            pump = NewEraPump(
                "in-process",
                rate_ml_per_min=RATE_ML_PER_MIN,
                diameter_mm=26.59,
                dead_man_s=NEW_ERA_DEAD_MAN_S,
                kind="emulated",
            )
            pump._port = pump._link._port = port
        return pump

    def accident(self, rng: random.Random) -> None:
        """Let one of the things happen that pumps and tanks are known for."""
        if isinstance(self.emulator, TankBoardEmulator):
            match rng.randrange(3):
                case 0:
                    self.emulator.leak_open = True
                case 1:
                    self.emulator.full_open = True
                case _:
                    self.emulator.power_cycle()
        else:
            rng.choice([self.emulator.stall, self.emulator.power_cycle, self.emulator.press_stop_key])()

    def mend(self) -> None:
        """Dry the floor, free the float."""
        if isinstance(self.emulator, TankBoardEmulator):
            self.emulator.leak_open = self.emulator.full_open = False


def cut(path: Path, length: int | None) -> None:
    """Take from a file what a dead controller wrote after its end."""
    if length is None:
        path.unlink(missing_ok=True)
    elif path.exists():
        with path.open("r+b") as file:
            file.truncate(length)
