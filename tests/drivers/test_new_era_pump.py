"""The driver of New Era pumps against an emulated pump on a pseudo terminal: what goes wrong, and what the operator reads."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest
from faults_page import OperatorReads
from pump_bench import dry_world

from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
    OutOfVolumeError,
)
from drivers.new_era_pump import NewEraPump
from drivers.new_era_settings import settings_for
from drivers.new_era_wire import ALARMS
from sim_backend.clock import SimulatedClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.new_era_memory import Memory, Phase
from sim_backend.wire import PtyServer
from sim_backend.world import World

WATCH_EVERY_S = 0.5


@dataclass(frozen=True)
class Bench:
    world: World
    emulator: NewEraEmulator
    wire: PtyServer

    def driver(self, **settings) -> NewEraPump:
        defaults = {"rate_ml_per_min": 600.0, "diameter_mm": 26.59, "reply_timeout_s": 0.3, "kind": "emulated"}
        return NewEraPump(self.wire.address, **(defaults | settings))

    def watch(self, pump: NewEraPump, duration_s: float) -> None:
        for _ in range(round(duration_s / WATCH_EVERY_S)):
            self.world.clock.sleep_s(WATCH_EVERY_S)
            pump.status()


@contextmanager
def bench_with(memory: Memory | None = None) -> Iterator[Bench]:
    world = dry_world(SimulatedClock())
    emulator = NewEraEmulator(world, memory=memory)
    with PtyServer(emulator) as wire:
        yield Bench(world, emulator, wire)


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


# Faults


def test_a_stall_ends_the_fill_with_its_reason(bench: Bench) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(pump, 2.0)
        bench.emulator.stall()
        status = pump.status()
        assert (status.running, status.alarm) == (False, "its motor stalled")
        assert status.moved_ml == pytest.approx(20.0)
        pump.stop()
        pump.start("fill", volume_ml=30.0, max_run_s=60.0)  # an alarm that was seen is over
        assert pump.status().alarm == ""


@pytest.mark.parametrize("happening", ["stall", "power_cycle"])
def test_an_alarm_before_the_start_swallows_nothing_that_matters(bench: Bench, happening: str) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=30.0, max_run_s=60.0)
        getattr(bench.emulator, happening)()
        pump.stop()
        before_ml = bench.world.state().tank_ml
        pump.start("fill", volume_ml=70.0, max_run_s=60.0)
        bench.watch(pump, 8.0)
        assert bench.world.state().tank_ml - before_ml == pytest.approx(70.0)


def test_power_that_fails_in_mid_fill_leaves_the_volume_unknown(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(pump, 2.0)
        bench.emulator.power_cycle()
        with operator_reads.raised(DeviceAlarmError):
            pump.status()
        pump.stop()
        with operator_reads.raised(DeviceAlarmError):
            pump.status()
    assert bench.world.state().tank_ml == pytest.approx(20.0)


def test_power_that_fails_between_two_questions_leaves_the_volume_unknown_as_well(
    bench: Bench, operator_reads: OperatorReads
) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(pump, 2.0)
        bench.emulator.reset_before.append("DIS")  # it runs when it is asked for its status, and not for its counter
        with operator_reads.raised(DeviceAlarmError):
            pump.status()


def test_the_stop_key_of_the_pump_is_an_end_with_a_reason(bench: Bench) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(pump, 2.0)
        bench.emulator.press_stop_key()
        assert pump.status().alarm == "somebody stopped it at its own keys"
        pump.start("fill", volume_ml=30.0, max_run_s=60.0)  # begins anew and does not go on with the old volume
        bench.watch(pump, 30.0)
        assert bench.world.state().tank_ml == pytest.approx(50.0)


def test_a_lost_reply_to_run_is_made_up_by_asking_and_never_by_running_twice(bench: Bench) -> None:
    bench.emulator.mute_after.append("RUN")
    with bench.driver() as pump:
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.watch(pump, 11.0)
        assert bench.emulator.commands.count("RUN") == 1
        assert bench.world.state().tank_ml == pytest.approx(100.0)


def test_a_run_that_never_arrived_is_an_error_and_not_a_fill(operator_reads: OperatorReads, bench: Bench) -> None:
    bench.emulator.deaf_to.append("RUN")
    with bench.driver() as pump:
        with operator_reads.raised(DeviceTimeoutError):
            pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.world.clock.sleep_s(60.0)
        assert bench.world.state().tank_ml == 0.0


def test_an_alarm_in_answer_to_run_is_an_error_and_nothing_flows(operator_reads: OperatorReads, bench: Bench) -> None:
    bench.emulator.reset_before.append("RUN")
    with bench.driver() as pump:
        with operator_reads.raised(DeviceAlarmError):
            pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.world.clock.sleep_s(60.0)
        assert bench.world.state().tank_ml == 0.0
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.watch(pump, 11.0)
        assert bench.world.state().tank_ml == pytest.approx(100.0)


@pytest.mark.parametrize("command", ["DIA", "RAT", "VOL", "DIR", "CLD", "PHN", "FUN", "SAF"])
def test_an_alarm_at_any_command_before_run_swallows_nothing_for_good(bench: Bench, command: str) -> None:
    bench.emulator.memory.phases[2] = Phase(rate=60.0, volume=0.0)
    with bench.driver() as pump:
        bench.emulator.reset_before.append(command)
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.watch(pump, 20.0)
        assert bench.world.state().tank_ml == pytest.approx(100.0)


@pytest.mark.parametrize("answer", ["?", "?NA", "?OOR", "?COM", "?IGN"])
def test_a_command_that_the_pump_refuses_is_said_with_its_reason(
    bench: Bench, operator_reads: OperatorReads, answer: str
) -> None:
    with bench.driver() as pump:
        bench.emulator.answers["RUN"] = [answer]
        with operator_reads.raised(DeviceProtocolError):
            pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.world.clock.sleep_s(60.0)
        assert bench.world.state().tank_ml == 0.0


def test_a_volume_beyond_the_pump_is_refused_by_the_pump(bench: Bench, operator_reads: OperatorReads) -> None:
    with bench.driver() as pump:
        bench.emulator.answers["VOL300.0"] = ["?OOR"]
        with operator_reads.raised(OutOfVolumeError):
            pump.start("fill", volume_ml=300.0, max_run_s=60.0)


def test_a_pump_without_safe_mode_pumps_in_basic_mode_alone(bench: Bench, operator_reads: OperatorReads) -> None:
    bench.emulator.answers = {"SAF0": ["?"] * 9, "SAF5": ["?"]}
    with bench.driver() as pump, operator_reads.raised(DeviceProtocolError):
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
    with bench.driver(mode="basic") as pump:
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.watch(pump, 11.0)
    assert bench.world.state().tank_ml == pytest.approx(100.0)


def test_a_dead_man_time_that_reads_back_otherwise_starts_nothing(bench: Bench, operator_reads: OperatorReads) -> None:
    with bench.driver() as pump:
        bench.emulator.answers["SAF"] = ["50"]
        with operator_reads.raised(DeviceProtocolError):
            pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        assert "RUN" not in bench.emulator.commands


@pytest.mark.parametrize(
    ("answers", "memory"),
    [
        pytest.param({"PF": ["1"] * 2}, Memory(power_fail_restart=True), id="restart"),
        pytest.param({"FUN": ["RAT"] * 2}, Memory(phases={1: Phase(), 2: Phase(rate=60.0)}), id="program"),
        pytest.param({"DIS": ["I12.00W0.000ML"]}, Memory(), id="counter"),
        pytest.param({"DIS": ["a lot"]}, Memory(), id="count"),
        pytest.param({"RAT": ["fast"]}, Memory(), id="number"),
    ],
)
def test_a_pump_that_does_not_take_what_it_is_told_starts_nothing(
    operator_reads: OperatorReads, answers: dict[str, list[str]], memory: Memory
) -> None:
    with bench_with(memory) as bench, bench.driver() as pump:
        bench.emulator.answers = answers
        with operator_reads.raised(DeviceProtocolError):
            pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        assert "RUN" not in bench.emulator.commands


@pytest.mark.parametrize("alarm", ALARMS)
def test_an_alarm_that_does_not_end_is_said(bench: Bench, operator_reads: OperatorReads, alarm: str) -> None:
    with bench.driver() as pump:
        bench.emulator.rings_for_ever = alarm
        bench.emulator.ring(alarm)
        with operator_reads.raised(DeviceAlarmError):
            pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.emulator.rings_for_ever = ""
    assert bench.world.state().tank_ml == 0.0


def test_a_pump_of_another_number_on_the_same_wire_is_named(bench: Bench, operator_reads: OperatorReads) -> None:
    original = bench.wire.faults.to_host
    bench.wire.faults.to_host = lambda data: original(data.replace(b"\x0200", b"\x0203"))
    with operator_reads.raised(DeviceProtocolError):
        bench.driver().__enter__()


def test_another_make_of_pump_is_refused(bench: Bench, operator_reads: OperatorReads) -> None:
    original = bench.wire.faults.to_host
    bench.wire.faults.to_host = lambda data: original(data.replace(b"\x0200S", b"\x0200OK"))
    with operator_reads.raised(DeviceProtocolError):
        bench.driver().__enter__()


@pytest.mark.parametrize("command", ["STP", "DIS", "VOL300.0", "SAF"])
def test_a_lost_question_or_reply_is_asked_again(bench: Bench, command: str) -> None:
    with bench.driver() as pump:
        name = command[:3]
        bench.emulator.deaf_to.append(name)
        bench.emulator.mute_after.append(name)
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(pump, 2.0)
        pump.stop()
        assert bench.world.state().tank_ml == pytest.approx(20.0)
        assert pump.status().moved_ml == pytest.approx(20.0)


def test_noise_on_the_line_is_passed_over(bench: Bench) -> None:
    with bench.driver() as pump:
        for noise in (b"\x02\x07\xff\xff", b"\x0200", b"\x02\x08garbage\x03", b"\xfe\x02\x30\x30Q\x03"):
            bench.wire.faults.inject(noise)
            assert not pump.status().running
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.wire.faults.inject(b"\x02\x0700S\x00\x00\x03")  # a Safe-mode reply whose check value is wrong
        assert pump.status().running


def test_a_pump_that_falls_silent_is_named_with_what_ends_the_flow(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.wire.faults.silent = bench.wire.faults.deaf = True
        with operator_reads.raised(DeviceTimeoutError):
            pump.status()
        with operator_reads.raised(DeviceTimeoutError):
            pump.stop()
        bench.world.clock.sleep_s(60.0)
        assert bench.world.state().tank_ml == pytest.approx(50.0)
        bench.wire.faults.silent = bench.wire.faults.deaf = False


def test_in_basic_mode_the_sentence_sends_the_operator_to_the_mains(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    with bench.driver(mode="basic") as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.wire.faults.silent = bench.wire.faults.deaf = True
        with operator_reads.raised(DeviceTimeoutError):
            pump.stop()
        bench.wire.faults.silent = bench.wire.faults.deaf = False


def test_a_cable_that_is_pulled_in_mid_fill_is_named_and_the_pump_stops_itself(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.wire.vanish()
        bench.world.clock.sleep_s(600.0)
        with operator_reads.raised(DeviceNotFoundError):
            pump.status()
        with operator_reads.raised(DeviceNotFoundError):
            pump.stop()
        pump._port.close()
    assert bench.world.state().tank_ml == pytest.approx(50.0)


def test_a_port_where_nothing_answers_is_named_with_what_to_check(operator_reads: OperatorReads, bench: Bench) -> None:
    bench.wire.faults.silent = True
    with operator_reads.raised(DeviceNotFoundError):
        bench.driver().__enter__()


def test_a_device_that_is_no_pump_is_refused(operator_reads: OperatorReads, bench: Bench) -> None:
    bench.emulator.version = "Grbl 1.1h"
    with operator_reads.raised(DeviceProtocolError):
        bench.driver().__enter__()


def test_a_second_start_is_refused_with_what_to_do(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver() as pump:
        pump.start("fill", volume_ml=300.0, max_run_s=60.0)
        with operator_reads.raised(DeviceBusyError):
            pump.start("fill", volume_ml=300.0, max_run_s=60.0)


def test_stopping_a_pump_that_was_never_opened_is_harmless(bench: Bench) -> None:
    bench.driver().stop()
