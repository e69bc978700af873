"""The tank that the tests of pumps share: 6 l of room, 5 l in the reservoir, nothing in it yet."""

import numpy as np

from drivers.protocols import Clock, Frame
from sim_backend.clock import SimulatedClock
from sim_backend.world import TankSize, World, WorldState


def dry_world(clock: Clock | None = None, *, tank_ml: float = 0.0, free_volume_ml: float = 6000.0) -> World:
    return World(
        clock=clock or SimulatedClock(),
        tank=TankSize(free_volume_ml, 4000.0),
        dark_frame=Frame(axis="x", levels=np.zeros(8, np.uint8)),
        state=WorldState(tank_ml=tank_ml, reservoir_ml=5000.0),
    )
