"""Somebody else's driver against our emulated pump: NESP-Lib, written by Florian Lapp from the same manuals."""

import time
from collections.abc import Iterator

import pytest
from pump_bench import dry_world

from sim_backend.clock import RealClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.wire import PtyServer
from sim_backend.world import World

nesp_lib = pytest.importorskip(
    "nesp_lib", reason="NESP-Lib is not installed; pip install NESP-Lib lets a second driver talk to the emulated pump"
)


@pytest.fixture
def world() -> World:
    return dry_world(RealClock())


@pytest.fixture
def port(world: World) -> Iterator[object]:
    with PtyServer(NewEraEmulator(world)) as wire, nesp_lib.Port(wire.address) as port:
        yield port


def test_a_second_driver_sets_runs_and_stops_the_emulated_pump(port: object, world: World) -> None:
    pump = nesp_lib.Pump(port)
    assert (pump.model_number, pump.firmware_version) == (9000, (3, 928))
    pump.syringe_diameter_mm = 30.0
    pump.pumping_direction = nesp_lib.PumpingDirection.INFUSE
    pump.pumping_volume_ml = 2.0
    pump.pumping_rate_ml_per_min = 240.0
    assert pump.pumping_rate_ml_per_min == pytest.approx(240.0)
    pump.run(wait_while_running=True)
    assert pump.volume_infused_ml == pytest.approx(2.0, abs=1e-3)
    assert world.state().tank_ml == pytest.approx(2.0, abs=1e-3)


def test_a_second_driver_keeps_the_pump_alive_in_safe_mode_until_its_heartbeats_end(port: object, world: World) -> None:
    pump = nesp_lib.Pump(port, safe_mode_timeout_s=1)
    pump.syringe_diameter_mm = 30.0
    pump.pumping_volume_ml = 500.0
    pump.pumping_rate_ml_per_min = 60.0
    pump.run(wait_while_running=False)
    time.sleep(2.5)  # its thread sends a status question every half second
    assert pump.running
    beaten_ml = world.state().tank_ml
    assert beaten_ml > 2.0
    # The thread stops as it would in a program that dies; the pump's own timer has the last word.
    pump._Pump__heartbeat_event_timeout_s = 0.0
    pump._Pump__heartbeat_event.set()
    pump._Pump__heartbeat_thread.join()
    time.sleep(1.5)
    stopped_ml = world.state().tank_ml
    time.sleep(0.3)
    assert world.state().tank_ml == stopped_ml
    assert stopped_ml - beaten_ml < 2.0
    with pytest.raises(nesp_lib.StatusAlarmException) as alarm:
        _ = pump.status
    assert alarm.value.alarm_status == nesp_lib.AlarmStatus.TIMEOUT
