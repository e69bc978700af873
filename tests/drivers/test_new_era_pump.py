"""The driver of New Era pumps against an emulated pump on a pseudo terminal: what is sent, and the dead-man timer."""

import time
from collections.abc import Iterator

import pytest
from faults_page import OperatorReads
from new_era_bench import Bench, bench_with

from drivers.errors import (
    DeviceProtocolError,
    OutOfVolumeError,
)
from drivers.new_era_settings import settings_for
from sim_backend.new_era_memory import Memory, Phase


@pytest.fixture
def bench() -> Iterator[Bench]:
    with bench_with() as bench:
        yield bench


# What is sent


def test_says_who_answers(bench: Bench) -> None:
    with bench.driver() as pump:
        info = pump.info()
    assert (info.kind, info.model, info.version) == ("emulated", "New Era NE-9000", "3.928")
    assert info.address == bench.wire.address


@pytest.mark.parametrize(
    ("diameter_mm", "volume_ml", "sent", "units"),
    [
        (26.59, 300.0, "300.0", "ML"),
        (14.01, 4500.0, "4500", "ML"),
        (14.0, 2.5, "2500", "UL"),
        (4.8, 12.0, "12.00", "ML"),
    ],
)
def test_the_volume_is_sent_in_the_units_that_the_pump_says_it_counts_in(
    bench: Bench, diameter_mm: float, volume_ml: float, sent: str, units: str
) -> None:
    with bench.driver(diameter_mm=diameter_mm) as pump:
        pump.start("fill", volume_ml=volume_ml, max_run_s=3600.0)
        assert bench.emulator.memory.volume_units == units
        commands = bench.emulator.commands
        assert f"VOL{sent}" in commands
        assert "VOL0" not in commands
        # Units come before the number, and everything before RUN.
        assert max(i for i, c in enumerate(commands) if c.startswith("DIA")) < commands.index(f"VOL{sent}")
        assert commands.index(f"VOL{sent}") < commands.index("RUN")
        bench.watch(pump, 5.0)
        assert bench.world.state().tank_ml == pytest.approx(min(volume_ml, 50.0), rel=1e-3)


@pytest.mark.parametrize("volume_ml", [1e-7, 4e-7, 20000.0])
def test_a_volume_that_four_digits_cannot_hold_is_refused_and_nothing_is_sent(
    operator_reads: OperatorReads, bench: Bench, volume_ml: float
) -> None:
    with bench.driver() as pump:
        before = len(bench.emulator.commands)
        with operator_reads.raised(OutOfVolumeError):
            pump.start("fill", volume_ml=volume_ml, max_run_s=1e6)
        assert not any(command.startswith(("VOL", "RUN")) for command in bench.emulator.commands[before:])


def test_a_volume_sent_is_never_more_than_the_rate_moves_in_the_longest_run_time() -> None:
    settings = settings_for("fill", volume_ml=300.0, max_run_s=5.0, rate_ml_per_min=600.0, diameter_mm=26.59)
    assert settings.volume_ml == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("rate_ml_per_min", "text"), [(600.0, "600.0MM"), (0.0125, "12.50UM"), (1234.0, "1234MM"), (2e-5, "0.020UM")]
)
def test_a_rate_is_sent_in_units_that_carry_it(rate_ml_per_min: float, text: str) -> None:
    settings = settings_for("fill", volume_ml=1.0, max_run_s=1e6, rate_ml_per_min=rate_ml_per_min, diameter_mm=20.0)
    assert settings.rate + settings.rate_units == text


def test_a_rate_that_four_digits_round_to_nothing_is_refused(operator_reads: OperatorReads) -> None:
    with operator_reads.raised(OutOfVolumeError):
        settings_for("fill", volume_ml=1.0, max_run_s=1e9, rate_ml_per_min=1e-9, diameter_mm=20.0)


# What the pump makes of it


def test_a_rate_that_the_pump_rounds_is_noticed_and_nothing_flows(operator_reads: OperatorReads, bench: Bench) -> None:
    bench.emulator.rate_step = 1000.0  # 600 becomes 1000, 400 becomes 0
    for rate_ml_per_min in (600.0, 400.0):
        with bench.driver(rate_ml_per_min=rate_ml_per_min) as pump:
            with operator_reads.raised(DeviceProtocolError):
                pump.start("fill", volume_ml=300.0, max_run_s=60.0)
            bench.world.clock.sleep_s(60.0)
    assert bench.world.state().tank_ml == 0.0


def test_a_rate_beyond_the_pump_is_refused_by_the_pump_and_the_sentence_says_what_to_compare(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    with bench.driver(rate_ml_per_min=3000.0) as pump, operator_reads.raised(DeviceProtocolError):
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)


def test_a_program_that_somebody_left_behind_does_not_go_on_after_the_fill() -> None:
    left_behind = Memory(phases={1: Phase(rate=60.0, volume=50.0), 2: Phase(rate=60.0, volume=0.0)})
    with bench_with(left_behind) as bench, bench.driver() as pump:
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.watch(pump, 60.0)
        assert bench.world.state().tank_ml == pytest.approx(100.0)


def test_a_pump_that_would_start_by_itself_after_a_power_failure_is_cured_first() -> None:
    with bench_with(Memory(power_fail_restart=True)) as bench, bench.driver() as pump:
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        assert not bench.emulator.memory.power_fail_restart


@pytest.mark.parametrize("dead_man_s", [0, 256])
def test_a_dead_man_time_that_the_pump_does_not_know_is_refused(
    operator_reads: OperatorReads, bench: Bench, dead_man_s: int
) -> None:
    with operator_reads.raised(DeviceProtocolError):
        bench.driver(dead_man_s=dead_man_s)


# The dead-man timer


def test_the_pump_stops_itself_when_nobody_asks_for_its_status(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver(dead_man_s=5) as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(pump, 4.0)
        bench.world.clock.sleep_s(600.0)  # the sequencer hangs
        assert bench.world.state().tank_ml == pytest.approx(90.0)
        status = pump.status()
        assert not status.running
        assert status.moved_ml == pytest.approx(90.0)
        operator_reads(status.alarm)
        assert pump.status().alarm == status.alarm


def test_a_silence_after_the_flow_is_no_alarm_and_the_pump_does_not_ring(bench: Bench) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.watch(pump, 11.0)
        pump.stop()
        assert bench.emulator.memory.safe_s == 0
        bench.world.clock.sleep_s(7200.0)  # hours of photos
        assert pump.status().alarm == ""
        pump.start("drain", volume_ml=100.0, max_run_s=60.0)
        bench.watch(pump, 11.0)
        assert bench.world.state().tank_ml == pytest.approx(0.0, abs=1e-9)


def test_a_pump_left_in_safe_mode_with_an_alarm_is_brought_back(
    operator_reads: OperatorReads, bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        pump._port.close()  # the program dies: nobody stops, nobody leaves Safe mode
        bench.world.clock.sleep_s(600.0)
    assert bench.emulator.memory.safe_s == 5
    with bench.driver() as pump:
        operator_reads(next(record.getMessage() for record in caplog.records if "tank" in record.getMessage()))
        assert not pump.status().running
        pump.start("drain", volume_ml=50.0, max_run_s=60.0)
        bench.watch(pump, 6.0)
    assert bench.world.state().tank_ml == pytest.approx(0.0, abs=1e-9)


def test_a_pump_that_turns_when_it_is_opened_is_stopped_first(bench: Bench) -> None:
    for command in (b"RAT60.0MM\r", b"VOL0\r", b"RUN\r"):
        bench.emulator.receive(command)
    bench.world.clock.sleep_s(10.0)
    with bench.driver() as pump:
        bench.world.clock.sleep_s(60.0)
        assert not pump.status().running
    assert bench.world.state().tank_ml == pytest.approx(10.0)


def test_a_pump_that_is_slower_than_calibrated_is_stopped_when_its_time_is_over(bench: Bench) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=0.3)
        # The world's clock stands: this pump has moved next to nothing when the 0.3 s of the room are over.
        time.sleep(0.4)
        assert not pump.status().running
        bench.world.clock.sleep_s(60.0)
        assert bench.world.state().tank_ml < 3.0


@pytest.mark.parametrize("jump_s", [86400.0, -86400.0])
def test_a_wall_clock_that_is_put_right_in_mid_fill_changes_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, jump_s: float
) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        wall_clock = time.time
        monkeypatch.setattr(time, "time", lambda: wall_clock() + jump_s)
        bench.watch(pump, 5.0)
        assert pump.status().running
        bench.watch(pump, 6.0)
        assert bench.world.state().tank_ml == pytest.approx(100.0)
