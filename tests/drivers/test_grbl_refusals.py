"""What a GRBL controller refuses or holds back, and what a bad wire does, with the sentence that the operator reads."""

import threading
import time

import pytest
from faults_page import OperatorReads
from grbl_bench import TRAVEL_MM, build, homed, open_fails, opened, wait_until
from stage_bench import while_moving

from drivers.errors import (
    DeviceAlarmError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
    OutOfTravelError,
)
from drivers.grbl_link import GrblRefusal
from drivers.grbl_stage import GrblStage
from sim_backend.clock import SimulatedClock
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.grbl_homing import GrblFaults
from sim_backend.wire import PtyServer


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what never answers: the driver's patience is not what is tested."""
    monkeypatch.setattr("drivers.grbl_link.ANSWER_S", 0.5)


# Standing still


@pytest.mark.parametrize("state", ["Hold", "Door", "Sleep", "Check"])
def test_a_controller_that_stands_still_gets_no_move_that_it_would_carry_out_later(
    operator_reads: OperatorReads, state: str
) -> None:
    with homed() as rig:
        match state:
            case "Hold":
                rig.wire.faults.interfere(b"G90 G1 X-90 F60\n")
                while_moving(rig, lambda: rig.wire.faults.interfere(b"!"))
            case "Door":
                rig.emulator.open_door()
            case "Sleep" | "Check":
                rig.wire.faults.interfere(b"$SLP\n" if state == "Sleep" else b"$C\n")
        wait_until(lambda: rig.stage._status().state == state)
        rig.sent.clear()
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(50.0, timeout_s=60.0)
        assert not any(b"$J" in line for line in rig.sent)
        assert not rig.stage.is_homed()
        rig.emulator.door_is_open = False
        rig.stage.home(timeout_s=60.0)
        rig.stage.move_to_mm(50.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(50.0, abs=0.005)


def test_a_door_that_opens_during_a_move_stops_it_and_must_be_closed_before_homing(
    operator_reads: OperatorReads,
) -> None:
    with homed() as rig:
        while_moving(rig, rig.emulator.open_door)
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert not rig.world.is_moving()
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.home(timeout_s=60.0)
        rig.emulator.door_is_open = False
        rig.stage.home(timeout_s=60.0)
        assert rig.stage.is_homed()


# Refused


@pytest.mark.parametrize(
    ("line", "code", "settings"),
    [
        ("$J=X-5F100", 8, {}),
        ("G1X-5F100", 9, {}),
        ("$20=1", 10, {20: 0, 22: 0}),
        ("$H", 5, {20: 0, 22: 0}),
        ("$J=X-5F100", 12, {}),
        ("$J=X-5F100", 13, {}),
    ],
    ids=["8", "9", "10", "5", "12", "13"],
)
def test_what_the_controller_refuses_is_said_with_its_reason(
    operator_reads: OperatorReads, line: str, code: int, settings: dict[int, float]
) -> None:
    with opened(settings=settings) as rig:
        if code in (12, 13):  # the emulated machine is never that fast, and its door is not read between lines
            rig.wire.faults.to_host = lambda data: data.replace(b"error:8", b"error:%d" % code)
        with operator_reads.raised(GrblRefusal):
            rig.stage._link.command(line)


def test_a_target_that_the_controller_refuses_moves_nothing(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        rig.emulator.settings.store("130", "60")  # somebody changed it meanwhile
        with operator_reads.raised(OutOfTravelError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(0.0)


@pytest.mark.parametrize("settings", [{13: 1}, {130: 80.0}], ids=["inches", "travel"])
def test_settings_that_would_mislead_a_move_are_refused_on_opening(
    operator_reads: OperatorReads, settings: dict[int, float]
) -> None:
    with operator_reads.raised(DeviceProtocolError):
        open_fails(settings=settings)


def test_a_setting_that_is_missing_is_named_on_opening(operator_reads: OperatorReads) -> None:
    rig, wire = build()
    wire.faults.to_host = lambda data: data.replace(b"$130=101.000\r\n", b"")
    with wire, operator_reads.raised(DeviceProtocolError):
        rig.stage.__enter__()


@pytest.mark.parametrize("version", ["0.9j.20160303", "3.7 FluidNC v3.7.8"], ids=["0.9", "FluidNC"])
def test_a_firmware_other_than_grbl_1_1_is_refused_on_opening(operator_reads: OperatorReads, version: str) -> None:
    with operator_reads.raised(DeviceProtocolError):
        open_fails(version=version)


def test_work_coordinates_without_their_offset_are_not_guessed(operator_reads: OperatorReads) -> None:
    def ask_until_the_offset_was_told(emulator: GrblEmulator) -> None:
        emulator.poll()
        emulator.receive(b"??")

    with (
        opened(prepare=ask_until_the_offset_was_told, settings={10: 0}) as rig,
        operator_reads.raised(DeviceProtocolError),
    ):
        rig.stage.position_mm()


def test_a_controller_that_lost_its_settings_is_refused(operator_reads: OperatorReads) -> None:
    def corrupt(emulator: GrblEmulator) -> None:
        emulator.faults = GrblFaults(eeprom_is_corrupt=True)

    rig, wire = build(corrupt)
    rig.stage._banner_s = 10.0

    def switch_on() -> None:
        while not rig.stage._port.is_open:
            time.sleep(0.001)
        rig.emulator.power_cycle()

    threading.Thread(target=switch_on, daemon=True).start()
    with wire, operator_reads.raised(DeviceProtocolError):
        rig.stage.__enter__()


@pytest.mark.usefixtures("impatient")
def test_something_else_on_the_port_is_not_taken_for_a_stage(operator_reads: OperatorReads) -> None:
    class Modem:
        def receive(self, data: bytes) -> bytes:
            return b"ERROR\r\n" * data.count(b"\n")

        def poll(self) -> bytes:
            return b""

    with PtyServer(Modem()) as wire:
        stage = GrblStage(
            wire.address, travel_mm=TRAVEL_MM, velocity_mm_per_s=10.0, clock=SimulatedClock(), banner_s=0.05
        )
        with operator_reads.raised(DeviceTimeoutError):
            stage.__enter__()


# The wire


def test_a_silent_controller_is_a_timeout_and_not_a_hang(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        rig.wire.faults.silent = True
        with operator_reads.raised(DeviceTimeoutError):
            rig.stage.position_mm()
        rig.wire.faults.silent = False


def test_a_cable_pulled_out_during_a_jog_is_said_in_one_sentence(operator_reads: OperatorReads) -> None:
    rig, wire = build()

    def move_and_lose_the_cable() -> None:
        with rig.stage:
            rig.stage.home(timeout_s=60.0)
            while_moving(rig, wire.vanish)
            rig.stage.move_to_mm(90.0, timeout_s=60.0)

    with wire, operator_reads.raised(DeviceNotFoundError):
        move_and_lose_the_cable()


def test_noise_on_the_line_neither_ends_a_move_nor_changes_it() -> None:
    with homed() as rig:
        noisy = threading.Event()

        def make_noise() -> None:
            while not noisy.wait(0.003):
                rig.wire.faults.inject(b"\xff\x00\x81\xfe")

        thread = threading.Thread(target=make_noise)
        thread.start()
        try:
            rig.stage.move_to_mm(60.0, timeout_s=60.0)
        finally:
            noisy.set()
            thread.join()
        assert rig.world.stage_mm() == pytest.approx(60.0, abs=0.005)


def test_a_command_that_arrives_garbled_is_said_again_and_twice_is_a_bad_cable(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        original, garbled = rig.wire.faults.to_device, []

        def garble(data: bytes) -> bytes:
            if b"$J=" in data and len(garbled) < 1:
                garbled.append(data)
                data = data.replace(b"G21X", b"G2\xa1X")
            return original(data)

        rig.wire.faults.to_device = garble
        rig.stage.move_to_mm(50.0, timeout_s=60.0)
        assert garbled
        assert rig.world.stage_mm() == pytest.approx(50.0, abs=0.005)
        rig.wire.faults.to_device = lambda data: original(data.replace(b"G21X", b"G2\xa1X"))
        with operator_reads.raised(GrblRefusal):
            rig.stage.move_to_mm(60.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(50.0, abs=0.005)


@pytest.mark.usefixtures("impatient")
def test_a_lost_ok_does_not_lose_the_move() -> None:
    with homed() as rig:
        time.sleep(0.02)
        rig.wire.faults.drop_to_host(4)
        rig.stage.move_to_mm(60.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(60.0, abs=0.005)


def test_a_command_that_arrives_maimed_is_seen_in_where_the_stage_ends(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        rig.emulator.receive(b"")
        original = rig.wire.faults.to_device
        rig.wire.faults.to_device = lambda data: original(data.replace(b"X-51", b"X-5"))  # a digit gets lost
        with operator_reads.raised(DeviceProtocolError):
            rig.stage.move_to_mm(50.0, timeout_s=60.0)


def test_a_move_that_somebody_else_holds_or_cancels_is_not_called_done(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        while_moving(rig, lambda: rig.wire.faults.interfere(b"\x85"))
        with operator_reads.raised(DeviceProtocolError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)


def test_a_stop_from_another_thread_ends_a_move_that_then_does_not_claim_to_have_arrived() -> None:
    with homed() as rig:
        while_moving(rig, rig.stage.stop)
        with pytest.raises(DeviceProtocolError, match=r"the move to 90 mm ended at .* something cancelled it"):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert not rig.world.is_moving()


def test_a_carriage_that_stalls_is_beyond_what_grbl_can_know() -> None:
    """GRBL counts steps: an obstacle is seen by homing again, or by measuring, and by nothing else."""
    with homed() as rig:
        rig.emulator.push(3.0)
        assert rig.stage.position_mm() == pytest.approx(0.0, abs=0.005)
        assert rig.world.stage_mm() == pytest.approx(3.0)
        rig.stage.home(timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(0.0, abs=0.005)


def test_leaving_in_the_middle_of_a_move_leaves_the_stage_still() -> None:
    rig, wire = build()

    def fall_over() -> None:
        with rig.stage:
            rig.stage.home(timeout_s=60.0)
            rig.stage._begin_jog("$J=G53G90G21X-90F60")
            raise RuntimeError("the sequencer fell over")

    with wire:
        with pytest.raises(RuntimeError, match="fell over"):
            fall_over()
        stopped_mm = rig.world.stage_mm()
        rig.world.clock.sleep_s(10.0)
        assert rig.world.stage_mm() == stopped_mm < 89.0
