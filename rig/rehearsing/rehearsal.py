"""The simulated world of a rehearsal: how it begins, what a person does in it, and where it is kept between commands."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.protocols import Clock, Frame
from rig.config import RigConfig
from rig.planning.steps import Request
from sim_backend.clock import RealClock, SimulatedClock
from sim_backend.ptpip.process import Model
from sim_backend.scene import Scene
from sim_backend.world import TankSize, World, WorldState
from sim_backend.world_file import WorldFile, after_restart, load_state


@dataclass(frozen=True, slots=True)
class Simulation:
    """How to simulate: the scene, whether time passes as in a lab, and where the tank's state is kept between runs.

    ``wire``: the real drivers drive emulated devices, in place of simulated ones; ``camera_model`` is the camera then.
    ``own_noise``: every photo has noise of its own, as several photos of the same thing need.
    """

    scene: Scene
    real_time: bool = False
    state_file: Path | None = None
    wire: bool = False
    camera_model: Model = "generic"
    own_noise: bool = False


@contextmanager
def open_world(config: RigConfig, simulation: Simulation) -> Iterator[World]:
    """Build the simulated world, as its state file left it where there is one, and keep its state at every change.

    What a program that was killed left under way goes on: on the simulated clock from the moment of the kill (to a quarter
    of a second), in real time for as long as it took to come back.
    """
    delay_s = simulation.scene.display.latency_s
    if simulation.state_file is None:
        yield from _lasting_as_long_as_asked(
            new_world(config, _clock(simulation), fresh_state(config), light_delay_s=delay_s), simulation
        )
        return
    ledger = ledger_file(simulation)
    if ledger is not None and not simulation.state_file.exists():
        ledger.unlink(missing_ok=True)  # what was known of a world that is gone
    file = WorldFile(simulation.state_file)
    state = load_state(simulation.state_file) if simulation.state_file.exists() else fresh_state(config)
    clock = _clock(simulation, start_s=state.at_s, on_move=file.keep_time)
    if clock.now_s() < state.at_s:  # the machine was restarted, and its clock with it
        state = after_restart(state, clock.now_s())
    file.keep(state)
    try:
        yield from _lasting_as_long_as_asked(
            new_world(config, clock, state, on_change=file.keep, light_delay_s=delay_s), simulation
        )
    finally:
        file.close()


def _lasting_as_long_as_asked(world: World, simulation: Simulation) -> Iterator[World]:
    if simulation.own_noise:
        world.unrest.renew_noise()
    try:
        yield world
    finally:
        world.stop_flow()
        world.stop_motion()


def ledger_file(simulation: Simulation) -> Path | None:
    """Return where it is kept what the rig knows of the simulated liquid; None for a world that does not last."""
    path = simulation.state_file
    return None if path is None else path.with_name(path.name + ".liquid.jsonl")


def _clock(
    simulation: Simulation,
    *,
    start_s: float = 0.0,
    on_move: Callable[[float], None] = lambda now_s: None,  # noqa: ARG005
) -> Clock:
    return RealClock(on_move=on_move) if simulation.real_time else SimulatedClock(start_s, on_move=on_move)


def new_world(
    config: RigConfig,
    clock: Clock,
    state: WorldState,
    *,
    on_change: Callable[[WorldState], None] = lambda state: None,  # noqa: ARG005
    light_delay_s: float = 0.0,
) -> World:
    """Return the world of ``config`` with a dark display."""
    tank = config.tank
    # A thin object needs no liquid: a tank that is never filled stays dry.
    size = TankSize(tank.free_volume_ml, tank.fill_ml) if tank else TankSize(1.0, 1.0)
    dark = Frame(axis="x", levels=np.zeros(config.display.columns, dtype=np.uint8))
    world = World(
        clock=clock, tank=size, dark_frame=dark, state=state, on_change=on_change, light_delay_s=light_delay_s
    )
    board = config.capture.board
    if config.watch is not None or (board is not None and board.photos > 1):
        # Photos of the same frame are compared with each other: without noise of their own they would be one file twice.
        world.unrest.renew_noise()
    return world


def fresh_state(config: RigConfig) -> WorldState:
    """Return a rig as it is found in the morning: the liquid in the reservoir, the stage somewhere."""
    low_mm, high_mm = config.stage.travel_mm
    return WorldState(reservoir_ml=config.tank.reservoir_ml if config.tank else 0.0, stage_mm=(low_mm + high_mm) / 2)


class SimulatedOperator:
    """A person who does at once what they are asked."""

    def __init__(self, world: World) -> None:
        self._world = world

    @property
    def world(self) -> World:
        """Where this person is."""
        return self._world

    def do(self, request: Request, text: str) -> None:  # noqa: ARG002  (the request says it all)
        """Do it in the simulated world."""
        match request:
            case "insert_object" | "remove_object":
                self._world.place_object(request == "insert_object")
            case "fill_tank" | "drain_tank":
                self._world.pour_by_hand(self._world.tank.fill_ml if request == "fill_tank" else 0.0)

    def tank_ml(self, *, fill_ml: float) -> float:  # noqa: ARG002  (looks, instead of guessing)
        """Look at the tank."""
        return self._world.state().tank_ml
