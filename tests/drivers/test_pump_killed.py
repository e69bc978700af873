"""A program that is killed in mid-fill: nothing of it runs any more, and the pump stops all the same."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pump_bench import dry_world

from sim_backend.clock import RealClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import Emulator, PtyServer
from sim_backend.world import World

DEAD_MAN_S = 1.0
RATE_ML_PER_S = 10.0
# The controller: opens the real driver, starts a fill and watches it, as the sequencer does.
CONTROLLER = """
import sys, time
from drivers.new_era_pump import NewEraPump
from drivers.tank_board import TankBoard

DRIVERS = {
    "new era": lambda port: NewEraPump(port, rate_ml_per_min=600.0, diameter_mm=26.59, dead_man_s=1, kind="emulated"),
    "tank board": lambda port: TankBoard(port, fill_ml_per_min=600.0, drain_ml_per_min=600.0, kind="emulated"),
}
with DRIVERS[sys.argv[1]](sys.argv[2]) as pump:
    pump.start("fill", volume_ml=4000.0, max_run_s=480.0)
    print("pumping", flush=True)
    while pump.status().running:
        time.sleep(0.1)
"""


def tank_board(world: World) -> TankBoardEmulator:
    return TankBoardEmulator(world, fill_ml_per_s=RATE_ML_PER_S, drain_ml_per_s=RATE_ML_PER_S)


@pytest.mark.parametrize(("name", "emulate"), [("new era", NewEraEmulator), ("tank board", tank_board)])
def test_kill_9_in_mid_fill_stops_the_pump_within_its_dead_man_time_and_the_tank_holds_what_was_pumped(
    name: str, emulate: Callable[[World], Emulator]
) -> None:
    world = dry_world(RealClock())
    with PtyServer(emulate(world)) as wire:
        controller = subprocess.Popen(
            [sys.executable, "-c", CONTROLLER, name, wire.address],
            cwd=Path(__file__).parents[2],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert controller.stdout is not None
            assert controller.stdout.readline() == "pumping\n"
            time.sleep(2.0 * DEAD_MAN_S)  # longer than the timer: it is the status questions that keep the pump going
            assert world.flow_direction() == "fill"
            os.kill(controller.pid, signal.SIGKILL)
            assert controller.wait() == -signal.SIGKILL
            killed_ml = world.state().tank_ml
        finally:
            controller.kill()
            controller.wait()
            assert controller.stdout is not None
            controller.stdout.close()
        time.sleep(DEAD_MAN_S + 0.2)
        assert world.flow_direction() is None
        tank_ml = world.state().tank_ml
        time.sleep(0.3)
        assert world.state().tank_ml == tank_ml
    # It went on after the timer's time; how promptly a busy machine let it begin and look is another matter.
    assert 1.5 * DEAD_MAN_S * RATE_ML_PER_S <= killed_ml <= tank_ml
    assert tank_ml - killed_ml <= DEAD_MAN_S * RATE_ML_PER_S + 1e-6


@pytest.mark.parametrize(("name", "emulate"), [("new era", NewEraEmulator), ("tank board", tank_board)])
def test_a_program_that_is_suspended_in_mid_fill_finds_the_pump_off_when_it_wakes_up(
    name: str, emulate: Callable[[World], Emulator]
) -> None:
    """SIGSTOP is what a computer that goes to sleep does to its programs; how long it sleeps is nothing to the pump."""
    world = dry_world(RealClock())
    with PtyServer(emulate(world)) as wire:
        controller = subprocess.Popen(
            [sys.executable, "-c", CONTROLLER, name, wire.address],
            cwd=Path(__file__).parents[2],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert controller.stdout is not None
            assert controller.stdout.readline() == "pumping\n"
            os.kill(controller.pid, signal.SIGSTOP)
            stopped_ml = world.state().tank_ml
            time.sleep(DEAD_MAN_S + 0.2)
            assert world.flow_direction() is None
            tank_ml = world.state().tank_ml
            os.kill(controller.pid, signal.SIGCONT)
            assert controller.wait(timeout=30.0) == 0  # it sees that the pump stands, and leaves
        finally:
            controller.kill()
            controller.wait()
            assert controller.stdout is not None
            controller.stdout.close()
        assert world.flow_direction() is None
        assert world.state().tank_ml == tank_ml  # and starts nothing again
    assert tank_ml - stopped_ml <= DEAD_MAN_S * RATE_ML_PER_S + 1e-6
