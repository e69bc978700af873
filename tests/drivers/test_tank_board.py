"""The driver of the tank board against its emulator on a pseudo terminal."""

import time
from collections.abc import Iterator
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
from drivers.protocols import LevelSensor
from drivers.tank_board import TankBoard
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import PtyServer
from sim_backend.world import World

WATCH_EVERY_S = 0.5


@dataclass(frozen=True)
class Bench:
    world: World
    emulator: TankBoardEmulator
    wire: PtyServer

    def driver(self, **settings) -> TankBoard:
        defaults = {"fill_ml_per_min": 600.0, "drain_ml_per_min": 300.0, "kind": "emulated"}
        return TankBoard(self.wire.address, **(defaults | settings))

    def watch(self, board: TankBoard, duration_s: float) -> None:
        for _ in range(round(duration_s / WATCH_EVERY_S)):
            self.world.clock.sleep_s(WATCH_EVERY_S)
            board.status()


@pytest.fixture
def bench() -> Iterator[Bench]:
    world = dry_world()
    emulator = TankBoardEmulator(world, fill_ml_per_s=10.0, drain_ml_per_s=5.0, full_at_ml=5000.0)
    with PtyServer(emulator) as wire:
        yield Bench(world, emulator, wire)


def test_says_who_answers(bench: Bench) -> None:
    with bench.driver() as board:
        assert (board.info().kind, board.info().model, board.info().version) == ("emulated", "tank-board", "1")


def test_each_direction_has_its_own_rate(bench: Bench) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=50.0, max_run_s=60.0)
        assert "FILL 5000" in bench.emulator.lines
        bench.watch(board, 6.0)
        board.start("drain", volume_ml=50.0, max_run_s=60.0)
        assert "DRAIN 10000" in bench.emulator.lines
        bench.watch(board, 4.0)
        assert board.status().moved_ml == pytest.approx(20.0)
        bench.watch(board, 8.0)
        assert bench.world.state().tank_ml == pytest.approx(0.0, abs=1e-9)


def test_a_volume_of_less_than_a_millisecond_is_refused_and_one_beyond_the_cap_too(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    with bench.driver() as board:
        with operator_reads.raised(OutOfVolumeError):
            board.start("fill", volume_ml=0.004, max_run_s=60.0)
        with operator_reads.raised(OutOfVolumeError):
            board.start("fill", volume_ml=18001.0, max_run_s=1e5)
    assert bench.world.state().tank_ml == 0.0


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_was_never_measured_is_refused(operator_reads: OperatorReads, bench: Bench, rate: float) -> None:
    with operator_reads.raised(OutOfVolumeError):
        bench.driver(drain_ml_per_min=rate)


def test_the_pump_stops_within_a_second_when_nobody_asks_for_its_status(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(board, 4.0)
        bench.world.clock.sleep_s(600.0)  # the sequencer hangs
        assert bench.world.state().tank_ml == pytest.approx(50.0)
        status = board.status()
        assert not status.running
        assert status.moved_ml == pytest.approx(50.0)
        operator_reads(status.alarm)
        board.stop()
        assert board.status().alarm == status.alarm  # the board has forgotten it, the driver has not


def test_a_host_is_silent_in_its_own_time_however_fast_the_emulated_world_runs() -> None:
    world = dry_world()
    emulator = TankBoardEmulator(world, fill_ml_per_s=10.0, drain_ml_per_s=5.0, world_s_per_host_s=8.0)
    emulator.receive(b"STOP\nFILL 60000\n")
    world.clock.sleep_s(7.9)  # a little less than a second of the host
    assert b"OK HB FILLING" in emulator.receive(b"HB\n")
    world.clock.sleep_s(60.0)
    assert b"fault=heartbeat" in emulator.receive(b"HB\n")
    assert world.state().tank_ml == pytest.approx((7.9 + 8.0) * 10.0)


def test_an_overfull_tank_stops_the_fill_and_may_still_be_drained(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(board, 1.0)
        bench.emulator.full_open = True
        # Real milliseconds pass between the questions, on the world's clock none: the contact must stay open for 20 ms.
        bench.watch(board, 1.0)
        assert "over-fill contact is open" in board.status().alarm
        tank_ml = bench.world.state().tank_ml
        assert tank_ml <= 20.0
        with operator_reads.raised(OutOfVolumeError):
            board.start("fill", volume_ml=10.0, max_run_s=60.0)
        board.start("drain", volume_ml=tank_ml, max_run_s=60.0)
        bench.watch(board, 5.0)
        assert bench.world.state().tank_ml == pytest.approx(0.0, abs=0.01)


def test_a_leak_while_photos_are_taken_is_told_at_the_next_question_and_nothing_starts(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    with bench.driver() as board:
        bench.emulator.leak_open = True
        bench.world.clock.sleep_s(1.0)
        time.sleep(0.05)
        bench.world.clock.sleep_s(1.0)
        assert board.status().alarm.startswith("the leak contact is open: there is liquid beside the tank")
        with operator_reads.raised(DeviceAlarmError):
            board.start("drain", volume_ml=10.0, max_run_s=60.0)
        bench.emulator.leak_open = False
        board.start("fill", volume_ml=10.0, max_run_s=60.0)
        bench.watch(board, 2.0)
        assert board.status().alarm == ""


def test_liquid_over_the_rim_opens_the_leak_contact() -> None:
    world = dry_world(tank_ml=4990.0, free_volume_ml=5000.0)
    float_that_hangs_ml = float("inf")
    emulator = TankBoardEmulator(world, fill_ml_per_s=10.0, drain_ml_per_s=5.0, full_at_ml=float_that_hangs_ml)
    with PtyServer(emulator) as wire:
        bench = Bench(world, emulator, wire)
        with bench.driver() as board:
            board.start("fill", volume_ml=300.0, max_run_s=60.0)
            bench.watch(board, 6.0)
            assert "leak contact" in board.status().alarm
            assert world.state().overflow_ml <= 20.0


def test_power_that_fails_in_mid_fill_leaves_the_volume_unknown(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(board, 2.0)
        bench.emulator.power_cycle()
        with operator_reads.raised(DeviceAlarmError):
            board.status()
    assert bench.world.state().tank_ml == pytest.approx(20.0)


def test_a_lost_reply_to_the_start_is_made_up_by_asking_and_never_by_starting_twice(bench: Bench) -> None:
    bench.emulator.mute_after.append("FILL")
    with bench.driver() as board:
        board.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.watch(board, 11.0)
        assert bench.emulator.lines.count("FILL 10000") == 1
        assert bench.world.state().tank_ml == pytest.approx(100.0)


def test_a_start_that_never_arrived_is_an_error_and_not_a_fill(operator_reads: OperatorReads, bench: Bench) -> None:
    bench.emulator.deaf_to.append("FILL")
    with bench.driver() as board:
        with operator_reads.raised(DeviceProtocolError):
            board.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.world.clock.sleep_s(60.0)
    assert bench.world.state().tank_ml == 0.0


def test_a_start_that_arrived_garbled_is_stopped(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver() as board:
        command = bench.emulator._logic.command
        bench.emulator._logic.command = lambda line, now_ms: command(line.replace("FILL 1", "FILL 9"), now_ms)
        with operator_reads.raised(DeviceProtocolError):
            board.start("fill", volume_ml=100.0, max_run_s=60.0)
        assert bench.world.flow_direction() is None


@pytest.mark.parametrize("verb", ["HB", "STOP"])
def test_a_lost_question_or_reply_is_asked_again(bench: Bench, verb: str) -> None:
    with bench.driver() as board:
        bench.emulator.deaf_to.append(verb)
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.watch(board, 2.0)
        bench.emulator.mute_after.append(verb)
        board.stop()
        assert bench.world.state().tank_ml == pytest.approx(20.0)
        assert board.status().moved_ml == pytest.approx(20.0)


def test_noise_and_answers_to_other_questions_are_passed_over(bench: Bench) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.wire.faults.inject(
            b"\xff\xfe\n\nOK HB IDLE ran=\nOK STOP IDLE ran=0 left=0 fault=none leak=0 full=0 level=0\n"
        )
        assert board.status().running


def test_a_board_that_falls_silent_is_named_with_what_ends_the_flow(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.wire.faults.silent = bench.wire.faults.deaf = True
        with operator_reads.raised(DeviceTimeoutError):
            board.status()
        with operator_reads.raised(DeviceTimeoutError):
            board.stop()
        bench.world.clock.sleep_s(60.0)
        assert bench.world.state().tank_ml == pytest.approx(10.0)
        bench.wire.faults.silent = bench.wire.faults.deaf = False


def test_a_cable_that_is_pulled_in_mid_fill_is_named_and_the_pump_stops_itself(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        bench.wire.vanish()
        bench.world.clock.sleep_s(600.0)
        with operator_reads.raised(DeviceNotFoundError):
            board.status()
        board._port.close()
    assert bench.world.state().tank_ml == pytest.approx(10.0)


def test_a_port_where_no_board_answers_is_named(
    operator_reads: OperatorReads, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.tank_board.WAKE_UP_S", 0.6)
    bench.wire.faults.silent = True
    with operator_reads.raised(DeviceNotFoundError):
        bench.driver().__enter__()


def test_a_board_with_another_sketch_is_refused(
    bench: Bench, operator_reads: OperatorReads, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim_backend.tank_board_logic.IDENTITY", "tank-board/0")
    with operator_reads.raised(DeviceProtocolError):
        bench.driver().__enter__()


def test_a_fault_that_comes_between_stop_and_start_refuses_the_start(
    bench: Bench, operator_reads: OperatorReads
) -> None:
    with bench.driver() as board:
        answer = bench.emulator._answer

        def power_fails_before_the_start(line: bytes) -> bytes:
            if line.startswith(b"FILL"):
                bench.emulator.power_cycle()
            return answer(line)

        bench.emulator._answer = power_fails_before_the_start
        with operator_reads.raised(DeviceProtocolError):
            board.start("fill", volume_ml=10.0, max_run_s=60.0)
    assert bench.world.state().tank_ml == 0.0


def test_a_pump_that_does_not_stop_when_it_is_told_is_said(bench: Bench, operator_reads: OperatorReads) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        original = bench.wire.faults.to_host
        bench.wire.faults.to_host = lambda data: original(data.replace(b"STOP IDLE", b"STOP FILLING"))
        with operator_reads.raised(DeviceTimeoutError):
            board.stop()
        bench.wire.faults.to_host = original


@pytest.mark.parametrize("contact", ["leak_open", "full_open"])
def test_an_open_contact_is_found_before_anything_flows(
    bench: Bench, operator_reads: OperatorReads, contact: str
) -> None:
    with bench.driver() as board:
        setattr(bench.emulator, contact, True)
        bench.emulator.poll()
        bench.world.clock.sleep_s(1.0)
        with operator_reads.raised(DeviceAlarmError):
            board.rehearse()


def test_a_second_start_is_refused_with_what_to_do(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver() as board:
        board.start("fill", volume_ml=300.0, max_run_s=60.0)
        with operator_reads.raised(DeviceBusyError):
            board.start("drain", volume_ml=300.0, max_run_s=60.0)


# The level sensor


def test_the_level_is_interpolated_between_calibrated_points_and_refused_beyond(
    operator_reads: OperatorReads, bench: Bench
) -> None:
    # The emulated sensor reads a tenth of the millilitres.
    with bench.driver(level_points=[(400, 4000.0), (0, 0.0), (100, 1000.0)]) as board:
        sensor: LevelSensor = board
        assert sensor.volume_ml() == 0.0
        bench.world.pour_by_hand(2500.0)
        assert sensor.volume_ml() == pytest.approx(2500.0)
        bench.world.pour_by_hand(4500.0)
        with operator_reads.raised(DeviceProtocolError):
            sensor.volume_ml()


def test_a_level_sensor_without_calibration_says_so(operator_reads: OperatorReads, bench: Bench) -> None:
    with bench.driver() as board, operator_reads.raised(DeviceProtocolError):
        board.volume_ml()


def test_a_board_that_is_pump_and_sensor_may_be_entered_once_for_each(bench: Bench) -> None:
    board = bench.driver(level_points=[(0, 0.0), (500, 5000.0)])
    with board as pump, board as sensor:
        pump.start("fill", volume_ml=100.0, max_run_s=60.0)
        bench.watch(pump, 11.0)
        assert sensor.volume_ml() == pytest.approx(100.0)
    assert not board._port.is_open
