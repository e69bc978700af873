"""The GRBL stage and each thing that goes wrong with one, with the sentence that the operator reads."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from faults_page import OperatorReads

from drivers.errors import (
    DeviceAlarmError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
    OutOfTravelError,
    UnknownPositionError,
)
from drivers.grbl_link import GrblRefusal
from drivers.grbl_stage import GrblStage
from drivers.protocols import Frame
from sim_backend.clock import SimulatedClock
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.grbl_homing import GrblFaults
from sim_backend.wire import PtyServer, Rfc2217Server, WireServer
from sim_backend.world import TankSize, World, WorldState

TRAVEL_MM = (0.0, 100.0)


@dataclass
class Rig:
    stage: GrblStage
    emulator: GrblEmulator
    wire: WireServer
    world: World
    sent: list[bytes]


def at_place(stage_mm: float = 37.0) -> World:
    dark = Frame(axis="x", levels=np.zeros(8, np.uint8))
    state = WorldState(stage_mm=stage_mm)
    return World(clock=SimulatedClock(), tank=TankSize(1.0, 1.0), dark_frame=dark, state=state)


def build(prepare: Callable[[GrblEmulator], None] | None = None, **of_emulator: object) -> tuple[Rig, WireServer]:
    world = at_place()
    emulator = GrblEmulator(world, travel_mm=TRAVEL_MM, **of_emulator)
    if prepare is not None:
        prepare(emulator)
    wire = PtyServer(emulator)
    sent: list[bytes] = []
    stage = GrblStage(
        wire.address,
        travel_mm=TRAVEL_MM,
        velocity_mm_per_s=10.0,
        clock=world.clock,
        banner_s=0.05,
        trace=lambda direction, _, data: sent.append(data) if direction == "sent" else None,
    )
    return Rig(stage, emulator, wire, world, sent), wire


@contextmanager
def opened(**settings: object) -> Iterator[Rig]:
    rig, wire = build(**settings)
    with wire, rig.stage:
        yield rig


@contextmanager
def homed(**settings: object) -> Iterator[Rig]:
    with opened(**settings) as rig:
        rig.stage.home(timeout_s=60.0)
        yield rig


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what never answers: the driver's patience is not what is tested."""
    monkeypatch.setattr("drivers.grbl_link.ANSWER_S", 0.5)


def open_fails(**settings: object) -> None:
    with opened(**settings):
        pass


def wait_until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def while_moving(rig: Rig, act: Callable[[], None]) -> None:
    """Do ``act`` from the side as soon as the carriage is under way, once."""

    def watch() -> None:
        deadline_s = time.monotonic() + 10.0
        while not rig.world.is_moving() and time.monotonic() < deadline_s:
            time.sleep(0.001)
        act()

    threading.Thread(target=watch, daemon=True).start()


# The way it should go


def test_moves_are_jogs_in_machine_coordinates_at_the_configured_speed() -> None:
    with homed() as rig:
        rig.sent.clear()
        started_s = rig.world.clock.now_s()
        rig.stage.move_to_mm(50.0, timeout_s=60.0)
        # 10 mm/s is 600 mm/min; with 1 mm of pull-off the carriage rests at -1, and 50 mm further at -51.
        assert b"$J=G53G90G21X-51.000F600.0\n" in rig.sent
        assert rig.world.clock.now_s() - started_s == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize(("mask", "rest"), [(0, -1.0), (1, -100.0)])
def test_a_switch_at_either_end_of_the_axis_gives_the_same_positions(mask: int, rest: float) -> None:
    with homed(settings={23: mask}) as rig:
        assert rig.emulator.axes.machine_mm()[0] == pytest.approx(rest)  # -$27, or -($130 - $27)
        rig.stage.move_to_mm(70.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(70.0, abs=0.005)
        assert rig.stage.position_mm() == pytest.approx(70.0, abs=0.005)


def test_a_controller_that_reports_work_coordinates_is_understood() -> None:
    with homed(settings={10: 0}) as rig:
        rig.stage._link.command("G92 X500")
        rig.stage.move_to_mm(20.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(20.0, abs=0.005)
        assert rig.stage.position_mm() == pytest.approx(20.0, abs=0.005)


def test_a_build_without_single_axis_homing_is_homed_as_a_whole() -> None:
    with homed(build_options="V") as rig:
        assert b"$H\n" in rig.sent
        assert rig.stage.is_homed()


def test_the_version_is_read_from_the_controller() -> None:
    with opened() as rig:
        assert rig.stage.info().version == "1.1h.20190830"
        assert rig.stage.info().address == rig.wire.address


def test_advises_to_keep_the_motor_energised_and_to_guard_the_travel(operator_reads: OperatorReads) -> None:
    with opened(settings={1: 25, 20: 0, 21: 0, 110: 300.0}) as rig:
        assert len(rig.stage.advice()) == 4
        for sentence in rig.stage.advice():
            operator_reads(f"stage: {sentence}")
    with opened() as rig:
        assert rig.stage.advice() == ()


# Position unknown


def test_a_controller_that_just_started_says_idle_at_zero_and_is_not_believed(operator_reads: OperatorReads) -> None:
    with opened(settings={22: 0, 20: 0}) as rig:
        assert rig.stage.position_mm() == pytest.approx(-1.0)  # it counts 0 wherever the carriage is
        assert rig.world.stage_mm() == 37.0
        with operator_reads.raised(UnknownPositionError):
            rig.stage.move_to_mm(20.0, timeout_s=60.0)
        with operator_reads.raised(DeviceProtocolError):
            rig.stage.home(timeout_s=60.0)


@pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning", "ignore:setName:DeprecationWarning")
def test_a_board_that_restarts_when_its_port_is_opened_must_be_homed_again() -> None:
    world = at_place()
    emulator = GrblEmulator(world, travel_mm=TRAVEL_MM)

    def restart(on: bool) -> None:
        if on:
            emulator.power_cycle()

    with Rfc2217Server(emulator, on_data_terminal_ready=restart) as wire:
        for _ in range(2):
            stage = GrblStage(
                wire.address, travel_mm=TRAVEL_MM, velocity_mm_per_s=10.0, clock=world.clock, banner_s=1.0
            )
            with stage:
                assert not stage.is_homed()
                stage.home(timeout_s=60.0)
                assert stage.is_homed()


def test_a_power_cut_between_two_moves_is_noticed_before_the_next(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        rig.emulator.power_cycle()
        time.sleep(0.05)
        assert not rig.stage.is_homed()
        with operator_reads.raised(UnknownPositionError):
            rig.stage.move_to_mm(20.0, timeout_s=60.0)
        rig.stage.home(timeout_s=60.0)
        rig.stage.move_to_mm(20.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(20.0, abs=0.005)


def test_a_power_cut_during_a_move_ends_it_and_says_why(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        while_moving(rig, rig.emulator.power_cycle)
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert not rig.stage.is_homed()


# Alarms


def test_alarm_1_a_limit_switch_hit_during_a_jog_stops_until_the_stage_is_homed(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        while_moving(rig, rig.emulator.hit_hard_limit)
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert not rig.world.is_moving()
        with pytest.raises(UnknownPositionError, match="home"):
            rig.stage.move_to_mm(10.0, timeout_s=60.0)
        rig.stage.home(timeout_s=60.0)
        rig.stage.move_to_mm(10.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(10.0, abs=0.005)


def test_alarm_2_a_soft_limit_with_its_late_ok_does_not_confuse_what_follows(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        with operator_reads.raised(DeviceAlarmError):
            rig.stage._link.command("G90 G1 X50 F100")
        rig.stage.home(timeout_s=60.0)  # resets; the late ok comes before the banner
        assert rig.stage.is_homed()
        rig.stage.move_to_mm(30.0, timeout_s=60.0)
        assert rig.stage.position_mm() == pytest.approx(30.0, abs=0.005)


def test_alarm_3_a_reset_in_mid_move_loses_the_position(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        while_moving(rig, lambda: rig.wire.faults.interfere(b"\x18"))
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert not rig.stage.is_homed()
        assert not rig.world.is_moving()


@pytest.mark.parametrize(
    ("faults", "options"),
    [
        pytest.param(GrblFaults(homing_ends_with=7), "VH", id="door"),
        pytest.param(GrblFaults(pull_off_is_stuck=True), "VH", id="pull-off"),
        pytest.param(GrblFaults(homing_switch_is_dead=True), "VH", id="switch"),
        pytest.param(GrblFaults(no_switch_on_z=True), "V", id="no switch on Z"),
        pytest.param(GrblFaults(homing_ends_with=10), "VH", id="second motor"),
    ],
)
def test_a_homing_that_fails_with_ok_is_still_a_failure(
    operator_reads: OperatorReads, faults: GrblFaults, options: str
) -> None:
    with opened(build_options=options) as rig:
        rig.emulator.faults = faults
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.home(timeout_s=120.0)
        assert not rig.stage.is_homed()
        rig.emulator.faults = GrblFaults()
        rig.stage.home(timeout_s=60.0)
        assert rig.stage.is_homed()


@pytest.mark.parametrize("happening", ["reset", "power cut"])
def test_a_homing_that_is_broken_off_is_a_failure(operator_reads: OperatorReads, happening: str) -> None:
    with opened() as rig:
        reset, power_cut = lambda: rig.wire.faults.interfere(b"\x18"), rig.emulator.power_cycle
        while_moving(rig, reset if happening == "reset" else power_cut)
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.home(timeout_s=60.0)
        assert not rig.stage.is_homed()
        rig.stage.home(timeout_s=60.0)
        assert rig.stage.is_homed()


def test_a_homing_that_the_controller_refuses_is_said_with_its_reason(operator_reads: OperatorReads) -> None:
    with opened() as rig:
        rig.emulator.settings.store("20", "0")
        rig.emulator.settings.store("22", "0")  # somebody changed it meanwhile
        with operator_reads.raised(DeviceProtocolError):
            rig.stage.home(timeout_s=60.0)


def test_homing_that_takes_too_long_is_stopped_by_a_reset(operator_reads: OperatorReads) -> None:
    with opened() as rig:
        with operator_reads.raised(DeviceTimeoutError):
            rig.stage.home(timeout_s=1.0)
        assert not rig.world.is_moving()
        assert not rig.stage.is_homed()
        rig.stage.home(timeout_s=60.0)
        assert rig.stage.is_homed()


@pytest.mark.usefixtures("impatient")
def test_a_controller_found_deaf_after_an_alarm_is_woken_and_must_be_homed() -> None:
    with opened(prepare=lambda emulator: emulator.hit_hard_limit()) as rig:
        assert not rig.stage.is_homed()
        rig.stage.home(timeout_s=60.0)
        assert rig.stage.is_homed()


def test_a_controller_found_moving_is_stopped_on_opening() -> None:
    def set_off(emulator: GrblEmulator) -> None:
        emulator.receive(b"$X\n")
        emulator.receive(b"G91 G1 X-20 F60\n")

    with opened(prepare=set_off, settings={20: 0}) as rig:
        assert not rig.world.is_moving()
        assert not rig.stage.is_homed()


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
