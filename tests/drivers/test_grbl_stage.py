"""The GRBL stage: how it moves, what makes its position unknown, and its alarms, with the sentence that the operator reads."""

import time

import pytest
from faults_page import OperatorReads
from grbl_bench import TRAVEL_MM, at_place, homed, opened
from stage_bench import while_moving

from drivers.errors import (
    DeviceAlarmError,
    DeviceProtocolError,
    DeviceTimeoutError,
    UnknownPositionError,
)
from drivers.grbl_stage import GrblStage
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.grbl_homing import GrblFaults
from sim_backend.wire import Rfc2217Server


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what never answers: the driver's patience is not what is tested."""
    monkeypatch.setattr("drivers.grbl_link.ANSWER_S", 0.5)


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
