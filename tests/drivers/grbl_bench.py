"""A GRBL stage on an emulated controller, which the tests of the stage share."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from stage_bench import wait_for_those_aside

from drivers.grbl_stage import GrblStage
from drivers.protocols import Frame
from sim_backend.clock import SimulatedClock
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.wire import PtyServer, WireServer
from sim_backend.world import TankSize, World, WorldState

TRAVEL_MM = (0.0, 100.0)


@dataclass
class Rig:
    stage: GrblStage
    emulator: GrblEmulator
    wire: WireServer
    world: World
    sent: list[bytes]
    aside: list[threading.Thread] = field(default_factory=list)


def at_place(stage_mm: float = 37.0) -> World:
    dark = Frame(axis="x", levels=np.zeros(8, np.uint8))
    state = WorldState(stage_mm=stage_mm)
    return World(clock=SimulatedClock(), tank=TankSize(1.0, 1.0), dark_frame=dark, state=state)


def build(prepare: Callable[[GrblEmulator], None] | None = None, **of_emulator: object) -> tuple[Rig, WireServer]:
    world = at_place()
    emulator = GrblEmulator(world, travel_mm=TRAVEL_MM, **of_emulator)
    if prepare is not None:
        prepare(emulator)
    wire = PtyServer(emulator)
    sent: list[bytes] = []
    stage = GrblStage(
        wire.address,
        travel_mm=TRAVEL_MM,
        velocity_mm_per_s=10.0,
        clock=world.clock,
        banner_s=0.05,
        trace=lambda direction, _, data: sent.append(data) if direction == "sent" else None,
    )
    return Rig(stage, emulator, wire, world, sent), wire


@contextmanager
def opened(**settings: object) -> Iterator[Rig]:
    rig, wire = build(**settings)
    with wire, rig.stage:
        try:
            yield rig
        finally:
            wait_for_those_aside(rig)


@contextmanager
def homed(**settings: object) -> Iterator[Rig]:
    with opened(**settings) as rig:
        rig.stage.home(timeout_s=60.0)
        yield rig


def open_fails(**settings: object) -> None:
    with opened(**settings):
        pass


def wait_until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
