"""What the tests of stages share: something that happens from the side while the carriage is under way."""

import threading
import time
from collections.abc import Callable
from typing import Protocol

from sim_backend.world import World


class MovingRig(Protocol):
    """A rig with a stage; it waits for the threads ``aside`` before it closes the stage's port, which they may be using."""

    world: World
    aside: list[threading.Thread]


def while_moving(rig: MovingRig, act: Callable[[], object]) -> None:
    """Do ``act`` from the side as soon as the carriage is under way, once."""

    def watch() -> None:
        deadline_s = time.monotonic() + 10.0
        while not rig.world.is_moving() and time.monotonic() < deadline_s:
            time.sleep(0.001)
        act()

    thread = threading.Thread(target=watch, daemon=True)
    rig.aside.append(thread)
    thread.start()


def wait_for_those_aside(rig: MovingRig) -> None:
    """Wait until all that :func:`while_moving` began has been done."""
    for thread in rig.aside:
        thread.join()
