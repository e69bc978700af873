"""The Zaber stage and each thing that goes wrong with one, with the sentence that the operator reads."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import pytest
from faults_page import OperatorReads
from stage_bench import wait_for_those_aside, while_moving

from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
    OutOfTravelError,
    UnknownPositionError,
)
from drivers.protocols import Frame
from drivers.zaber_protocol import (
    CONCERNS,
    FAULTS,
    REJECTIONS,
    ZaberMessage,
    checksum,
    read_message,
    write_command,
)
from drivers.zaber_stage import ZaberStage
from sim_backend.clock import SimulatedClock
from sim_backend.wire import PtyServer
from sim_backend.world import TankSize, World, WorldState
from sim_backend.zaber_emulator import ZaberEmulator

MICROSTEP_MM = 0.000047625
TRAVEL_MM = (0.0, 100.0)


@dataclass
class Rig:
    world: World
    emulator: ZaberEmulator
    wire: PtyServer
    stage: ZaberStage
    sent: list[bytes] = field(default_factory=list)
    aside: list[threading.Thread] = field(default_factory=list)


def build(**settings: object) -> Rig:
    dark = Frame(axis="x", levels=np.zeros(8, np.uint8))
    world = World(clock=SimulatedClock(), tank=TankSize(1.0, 1.0), dark_frame=dark, state=WorldState(stage_mm=37.0))
    emulator = ZaberEmulator(world, travel_mm=TRAVEL_MM, microstep_mm=MICROSTEP_MM, velocity_mm_per_s=25.0)
    wire = PtyServer(emulator)
    sent: list[bytes] = []
    wanted = {"microstep_mm": MICROSTEP_MM, "travel_mm": TRAVEL_MM, "velocity_mm_per_s": 10.0} | settings
    stage = ZaberStage(
        wire.address,
        clock=world.clock,
        trace=lambda direction, _, data: sent.append(data) if direction == "sent" else None,
        **wanted,
    )
    return Rig(world, emulator, wire, stage, sent)


@contextmanager
def opened(**settings: object) -> Iterator[Rig]:
    rig = build(**settings)
    with rig.wire, rig.stage:
        try:
            yield rig
        finally:
            wait_for_those_aside(rig)


@contextmanager
def homed(**settings: object) -> Iterator[Rig]:
    with opened(**settings) as rig:
        rig.stage.home(timeout_s=60.0)
        yield rig


def open_fails(**settings: object) -> None:
    with opened(**settings):
        pass


# The frame, with the examples of the manual and of zproto


@pytest.mark.parametrize(
    ("body", "digits"),
    [
        (b"1 0 00 get pos", b"2D"),
        (b"1 1 02 home", b"33"),
        (b"1 1 03", b"FB"),
        (b"1 1 10 move abs 5000", b"EB"),
        (b"01 0 00 OK IDLE WR 0", b"BE"),
        (b"01 tools echo", b"8F"),
    ],
)
def test_checksums_are_those_of_the_manual(body: bytes, digits: bytes) -> None:
    assert checksum(body) == digits


def test_a_status_poll_has_no_words_and_the_frame_of_the_manual() -> None:
    assert write_command("", device=1, axis=1, message_id=3) == b"/1 1 03:FB\n"


def test_replies_alerts_and_infos_are_told_apart_and_a_wrong_checksum_is_noise() -> None:
    reply = ZaberMessage("@", 1, 0, "00", accepted=True, busy=False, flag="WR", data="0")
    assert read_message(b"@01 0 00 OK IDLE WR 0:BE\r\n") == reply
    assert read_message(b"\xff\x00@01 0 00 OK IDLE WR 0:BE\r\n") == reply
    assert read_message(b"@01 0 00 OK IDLE WR 1:BE\r\n") is None
    assert read_message(b"!01 1 IDLE --\r\n") == ZaberMessage("!", 1, 1, data="IDLE --")
    assert read_message(b"#01 0 setting saved\r\n") == ZaberMessage("#", 1, 0, data="setting saved")
    assert read_message(b"nonsense\r\n") is None


# The way it should go


def test_every_command_carries_an_id_and_a_checksum_and_positions_are_microsteps() -> None:
    with homed() as rig:
        rig.sent.clear()
        started_s = rig.world.clock.now_s()
        rig.stage.move_to_mm(47.625, timeout_s=60.0)
        (move,) = [line for line in rig.sent if b"move" in line]
        assert move.startswith(b"/1 1 ")
        assert b" move abs 1000000:" in move  # 47.625 mm of 0.000047625 mm each
        assert rig.world.clock.now_s() - started_s == pytest.approx(4.76, abs=0.5)  # at 10 mm/s, not at its own 25
        for line in rig.sent:
            assert checksum(line[1:-4]) == line[-3:-1]


def test_the_device_says_who_it_is() -> None:
    with opened() as rig:
        assert rig.stage.info().model == "Zaber device 50081"
        assert rig.stage.info().version == "7.35"


def test_a_stage_that_was_homed_is_still_homed_when_its_port_is_opened_again() -> None:
    rig = build()
    with rig.wire:
        with rig.stage:
            rig.stage.home(timeout_s=60.0)
        with rig.stage:
            assert rig.stage.is_homed()
            rig.stage.move_to_mm(20.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(20.0, abs=0.001)


def test_alerts_infos_and_noise_do_not_disturb_a_move() -> None:
    with homed() as rig:
        rig.stage._link.ask("set comm.alert 1", of_axis=False)
        while_moving(rig, lambda: (rig.emulator.remark("setting saved"), rig.wire.faults.inject(b"\xff@!\x00\r\n")))
        rig.stage.move_to_mm(60.0, timeout_s=60.0)
        rig.stage.move_to_mm(10.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(10.0, abs=0.001)


# Position unknown


def test_a_power_cut_between_two_moves_is_noticed_before_the_next(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        rig.emulator.power_cycle()
        assert not rig.stage.is_homed()
        with operator_reads.raised(UnknownPositionError):
            rig.stage.move_to_mm(20.0, timeout_s=60.0)


def test_a_power_cut_during_a_move_is_not_called_done(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        while_moving(rig, rig.emulator.power_cycle)
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert not rig.stage.is_homed()


# Warning flags


@pytest.mark.parametrize("flag", FAULTS)
def test_a_fault_during_a_move_is_a_failure_though_the_device_is_idle(operator_reads: OperatorReads, flag: str) -> None:
    with homed() as rig:
        while_moving(rig, lambda: rig.emulator.fail(flag))
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert not rig.world.is_moving()


@pytest.mark.parametrize("flag", CONCERNS)
def test_a_concern_during_a_move_is_told_and_the_move_goes_on(
    operator_reads: OperatorReads, flag: str, caplog: pytest.LogCaptureFixture
) -> None:
    with homed() as rig:
        while_moving(rig, lambda: rig.emulator.warn(flag))
        rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(90.0, abs=0.001)
        (record,) = caplog.records
        operator_reads(record.getMessage())


def test_a_power_cut_during_homing_is_no_reference(operator_reads: OperatorReads) -> None:
    with opened() as rig:
        while_moving(rig, rig.emulator.power_cycle)
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.home(timeout_s=60.0)
        assert not rig.stage.is_homed()


def test_a_stage_that_was_pushed_while_it_stood_wants_to_be_homed(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        rig.stage.move_to_mm(50.0, timeout_s=60.0)
        rig.emulator.push(0.5)
        assert rig.stage.position_mm() == pytest.approx(50.5, abs=0.001)
        assert not rig.stage.is_homed()
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(20.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(50.5)
        rig.stage.home(timeout_s=60.0)
        rig.stage.move_to_mm(20.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(20.0, abs=0.001)


def test_a_stop_from_another_thread_ends_a_move_that_then_does_not_claim_to_have_arrived(
    operator_reads: OperatorReads,
) -> None:
    with homed() as rig:
        while_moving(rig, rig.stage.stop)
        with operator_reads.raised(DeviceAlarmError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert not rig.world.is_moving()


def test_a_move_after_one_that_was_stopped_succeeds(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        with operator_reads.raised(DeviceTimeoutError):
            rig.stage.move_to_mm(90.0, timeout_s=1.0)
        rig.stage.move_to_mm(20.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(20.0, abs=0.001)


# Refused


@pytest.mark.parametrize(
    "settings", [{"travel_mm": (0.0, 150.0)}, {"microstep_mm": MICROSTEP_MM / 2}], ids=["travel", "microstep"]
)
def test_a_travel_that_the_device_does_not_have_is_refused_on_opening(
    operator_reads: OperatorReads, settings: dict[str, object]
) -> None:
    with operator_reads.raised(DeviceProtocolError):
        open_fails(**settings)


def test_a_target_that_the_device_rejects_moves_nothing(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        rig.emulator.receive(b"/1 set limit.max 1000000\n")
        with operator_reads.raised(OutOfTravelError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(0.0)


@pytest.mark.parametrize("reason", [reason for reason in REJECTIONS if reason not in ("BADDATA", "BADAXIS")])
def test_a_rejected_move_is_said_with_its_reason_and_nothing_moves(operator_reads: OperatorReads, reason: str) -> None:
    with homed() as rig:
        rig.emulator.rejects["move"] = [reason] * 4
        with operator_reads.raised(DeviceBusyError if reason in ("AGAIN", "STATUSBUSY") else DeviceProtocolError):
            rig.stage.move_to_mm(90.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(0.0)


def test_a_device_that_cannot_answer_now_is_asked_again() -> None:
    with homed() as rig:
        rig.emulator.rejects = {"move": ["AGAIN"], "get": ["AGAIN", "AGAIN"]}
        rig.stage.move_to_mm(20.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(20.0, abs=0.001)


def test_a_device_that_answers_for_two_axes_is_refused_on_opening(operator_reads: OperatorReads) -> None:
    rig = build()
    rig.emulator._settings["limit.min"] = "0 0"  # as a controller of two axes answers
    with rig.wire, operator_reads.raised(DeviceProtocolError):
        rig.stage.__enter__()


def test_a_device_of_another_number_is_not_there(operator_reads: OperatorReads) -> None:
    with operator_reads.raised(DeviceTimeoutError):
        open_fails(device=2)


def test_an_axis_that_the_device_does_not_have_is_refused(operator_reads: OperatorReads) -> None:
    with operator_reads.raised(DeviceProtocolError):
        open_fails(axis=2)


# The wire


def test_a_silent_device_is_a_timeout_and_not_a_hang(operator_reads: OperatorReads) -> None:
    with homed() as rig:
        rig.wire.faults.silent = True
        with operator_reads.raised(DeviceTimeoutError):
            rig.stage.position_mm()
        rig.wire.faults.silent = False


def test_a_cable_pulled_out_during_a_move_is_said_in_one_sentence(operator_reads: OperatorReads) -> None:
    rig = build()

    def move_and_lose_the_cable() -> None:
        with rig.stage:
            rig.stage.home(timeout_s=60.0)
            while_moving(rig, rig.wire.vanish)
            rig.stage.move_to_mm(90.0, timeout_s=60.0)

    with rig.wire, operator_reads.raised(DeviceNotFoundError):
        move_and_lose_the_cable()


@pytest.mark.parametrize("direction", ["to_host", "to_device"])
def test_a_lost_byte_costs_a_repetition_and_nothing_else(direction: str) -> None:
    with homed() as rig:
        for _ in range(3):
            getattr(rig.wire.faults, f"drop_{direction}")(1)
            assert rig.stage.position_mm() == pytest.approx(0.0, abs=0.001)
        rig.stage.move_to_mm(60.0, timeout_s=60.0)
        assert rig.world.stage_mm() == pytest.approx(60.0, abs=0.001)


@pytest.mark.parametrize("lost", [b"move abs", b"@01 1"])
def test_a_lost_order_or_its_lost_reply_does_not_lose_the_move(lost: bytes) -> None:
    with homed() as rig:
        ordered = threading.Event()
        to_device, to_host = rig.wire.faults.to_device, rig.wire.faults.to_host

        def host_says(data: bytes) -> bytes:
            first = b"move abs" in data and not ordered.is_set()
            if first:
                ordered.set()
                if lost == b"move abs":
                    return to_device(b"")
                rig.wire.faults.drop_to_host(9)
            return to_device(data)

        rig.wire.faults.to_device = host_says
        rig.stage.move_to_mm(60.0, timeout_s=60.0)
        rig.wire.faults.to_device = to_device
        assert ordered.is_set()
        assert to_host(b"") == b""
        assert rig.world.stage_mm() == pytest.approx(60.0, abs=0.001)


def test_leaving_in_the_middle_of_a_move_leaves_the_stage_still() -> None:
    rig = build()

    def fall_over() -> None:
        with rig.stage:
            rig.stage.home(timeout_s=60.0)
            rig.stage._begin("move abs 2000000")
            raise RuntimeError("the sequencer fell over")

    with rig.wire:
        with pytest.raises(RuntimeError, match="fell over"):
            fall_over()
        stopped_mm = rig.world.stage_mm()
        rig.world.clock.sleep_s(60.0)
        assert rig.world.stage_mm() == stopped_mm < 90.0
