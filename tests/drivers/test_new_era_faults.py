"""The driver of New Era pumps against an emulated pump on a pseudo terminal: what goes wrong, and what the operator reads."""

from collections.abc import Iterator

import pytest
from faults_page import OperatorReads
from new_era_bench import Bench, bench_with

from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
    OutOfVolumeError,
)
from drivers.new_era_wire import ALARMS
from sim_backend.new_era_memory import Memory, Phase


@pytest.fixture
def bench() -> Iterator[Bench]:
    with bench_with() as bench:
        yield bench


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
