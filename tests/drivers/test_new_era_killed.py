"""A program that is killed in mid-fill: nothing of it runs any more, and the pump stops all the same."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pump_bench import dry_world

from sim_backend.clock import RealClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.wire import PtyServer

DEAD_MAN_S = 1
RATE_ML_PER_S = 10.0
# The controller: opens the real driver, starts a fill and watches it, as the sequencer does.
CONTROLLER = f"""
import sys, time
from drivers.new_era_pump import NewEraPump

with NewEraPump(
    sys.argv[1], rate_ml_per_min={RATE_ML_PER_S * 60}, diameter_mm=26.59, dead_man_s={DEAD_MAN_S}, kind="emulated"
) as pump:
    pump.start("fill", volume_ml=4000.0, max_run_s=480.0)
    print("pumping", flush=True)
    while pump.status().running:
        time.sleep(0.1)
"""


def test_kill_9_in_mid_fill_stops_the_pump_within_its_dead_man_time_and_the_tank_holds_what_was_pumped() -> None:
    world = dry_world(RealClock())
    emulator = NewEraEmulator(world)
    with PtyServer(emulator) as wire:
        controller = subprocess.Popen(
            [sys.executable, "-c", CONTROLLER, wire.address],
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
            controller.stdout.close()
        time.sleep(DEAD_MAN_S + 0.2)
        assert world.flow_direction() is None
        tank_ml = world.state().tank_ml
        time.sleep(0.3)
        assert world.state().tank_ml == tank_ml
    assert 2.0 * DEAD_MAN_S * RATE_ML_PER_S * 0.9 < killed_ml <= tank_ml
    assert tank_ml - killed_ml <= DEAD_MAN_S * RATE_ML_PER_S + 1e-6
    assert sum(emulator._motor.dispensed_ml.values()) == pytest.approx(tank_ml)
