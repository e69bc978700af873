"""The emulated GRBL against its documentation, and against a streaming client that other people wrote."""

import numpy as np
import pytest

from drivers.protocols import Frame
from sim_backend.clock import FastClock, SimulatedClock
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.wire import PtyServer
from sim_backend.world import TankSize, World, WorldState

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
LOCKED = b"[MSG:'$H'|'$X' to unlock]\r\n"


def world_on(clock: SimulatedClock | FastClock) -> World:
    dark = Frame(axis="x", levels=np.zeros(8, np.uint8))
    return World(clock=clock, tank=TankSize(1.0, 1.0), dark_frame=dark, state=WorldState(stage_mm=50.0))


class Console:
    """Types at an emulator and lets time pass."""

    def __init__(self, **settings: object) -> None:
        self.world = world_on(SimulatedClock())
        self.emulator = GrblEmulator(self.world, travel_mm=(0.0, 100.0), **settings)
        self.greeting = self.emulator.poll()

    def type(self, text: str | bytes) -> bytes:
        return self.emulator.receive(text.encode() if isinstance(text, str) else text)

    def after(self, duration_s: float) -> bytes:
        said = b""
        for _ in range(round(duration_s / 0.05)):
            self.world.clock.sleep_s(0.05)
            said += self.emulator.poll()
        return said

    def homed(self) -> "Console":
        self.type("$H\n")
        assert self.after(30.0) == b"ok\r\n"
        return self


def test_a_machine_with_homing_greets_locked_and_refuses_motion() -> None:
    console = Console()
    assert console.greeting == BANNER + LOCKED
    assert console.type("G1 X-1 F10\n") == b"error:9\r\n"
    assert console.type("$J=X-1 F10\n") == b"error:8\r\n"
    assert console.type("$X\n") == b"[MSG:Caution: Unlocked]\r\nok\r\n"


def test_carriage_return_and_newline_are_two_lines_and_get_two_answers() -> None:
    assert Console().type("\r\n") == b"ok\r\nok\r\n"


def test_a_status_report_has_the_documented_form_and_tells_the_offset_first() -> None:
    console = Console().homed()
    assert console.type("?") == b"<Idle|MPos:-1.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"
    assert console.type("?") == b"<Idle|MPos:-1.000,0.000,0.000|FS:0,0|Ov:100,100,100>\r\n"
    assert console.type("?") == b"<Idle|MPos:-1.000,0.000,0.000|FS:0,0>\r\n"


def test_ok_means_queued_and_a_dwell_is_answered_when_the_queue_is_empty() -> None:
    console = Console().homed()
    assert console.type("G90 G1 X-11 F600\n") == b"ok\r\n"  # 10 mm at 10 mm/s: one second
    assert console.type("G4 P0.01\n") == b""
    assert console.after(0.9) == b""
    assert b"<Run|" in console.type("?")
    assert console.after(0.3) == b"ok\r\n"
    assert console.world.stage_mm() == pytest.approx(10.0)


def test_the_planner_takes_fifteen_blocks_and_then_keeps_the_host_waiting() -> None:
    console = Console().homed()
    answers = console.type("".join(f"G1 X{-1 - n} F60\n" for n in range(1, 17)))
    assert answers.count(b"ok") == 15
    assert console.after(1.2).count(b"ok") == 1  # the first millimetre is done


def test_a_jog_beyond_the_travel_is_refused_and_a_move_beyond_it_is_an_alarm_with_a_late_ok() -> None:
    console = Console().homed()
    assert console.type("$J=G53 X1 F100\n") == b"error:15\r\n"
    assert console.type("$J=G53 X-101.1 F100\n") == b"error:15\r\n"
    assert console.type("$J=G53 X-5\n") == b"error:22\r\n"
    assert console.type("$J=G1 X-5 F100\n") == b"error:16\r\n"
    assert console.type("G90 G0 X1\n") == b"ALARM:2\r\n"
    assert console.type("?") == b""  # deaf until it is reset
    assert console.after(0.6) == b"[MSG:Reset to continue]\r\n"
    assert console.type(b"\x18") == b"ok\r\n" + BANNER + LOCKED


def test_a_jog_can_be_cancelled_and_leaves_the_modes_alone() -> None:
    console = Console().homed()
    before = console.type("$G\n")
    assert console.type("$J=G91 G20 X-2 F10\n") == b"ok\r\n"
    console.after(0.5)
    assert console.type("?").startswith(b"<Jog|")
    assert console.type("G1 X-5 F10\n") == b"error:9\r\n"
    console.type(b"\x85")
    assert not console.world.is_moving()
    assert console.type("?").startswith(b"<Idle|")
    assert console.type("$G\n") == before


def test_a_reset_while_still_keeps_the_place_and_one_while_moving_loses_it() -> None:
    console = Console().homed()
    assert console.type(b"\x18") == BANNER
    assert b"MPos:-1.000" in console.type("?")
    console.type("G1 X-90 F600\n")
    console.after(1.0)
    assert console.type(b"\x18") == b"ALARM:3\r\n" + BANNER + LOCKED


def test_during_homing_only_a_reset_is_heard() -> None:
    console = Console()
    assert console.type("$H\n?") == b""
    console.after(0.5)
    assert console.type(b"\x18") == b"ALARM:6\r\nok\r\n" + BANNER + LOCKED
    assert not console.world.is_moving()


def test_a_hold_stops_and_a_start_goes_on_to_the_same_target() -> None:
    console = Console().homed()
    console.type("G1 X-21 F600\n")
    console.after(1.0)
    console.type("!")
    assert console.type("?").startswith(b"<Hold:1|")
    console.after(5.0)
    assert console.type("?").startswith(b"<Hold:0|")
    assert 5.0 < console.world.stage_mm() < 15.0
    console.type("~")
    console.after(2.0)
    assert console.world.stage_mm() == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("X", b"error:2\r\n"),
        ("5", b"error:1\r\n"),
        ("$99=1", b"error:3\r\n"),
        ("$0=-1", b"error:4\r\n"),
        ("$0=2", b"error:6\r\n"),
        ("G5", b"error:20\r\n"),
        ("G0 G1 X-2", b"error:21\r\n"),
        ("G1 X-2", b"error:22\r\n"),
        ("X-1 X-2", b"error:25\r\n"),
        ("G53 G0", b"error:26\r\n"),
        ("G4", b"error:28\r\n"),
        ("X" + "1" * 80, b"error:11\r\n"),
        ("(a comment) ; another", b"ok\r\n"),
        ("g 21 g 90", b"ok\r\n"),
    ],
)
def test_bad_lines_get_the_documented_error(line: str, answer: bytes) -> None:
    assert Console().homed().type(line + "\n") == answer


def test_settings_survive_and_soft_limits_need_homing() -> None:
    console = Console(settings={20: 0, 22: 0})
    assert console.greeting == BANNER
    assert console.type("$20=1\n") == b"error:10\r\n"
    assert console.type("$1=255\n") == b"ok\r\n"
    console.emulator.power_cycle()
    console.emulator.poll()
    assert b"$1=255\r\n" in console.type("$$\n")
    assert console.type("$I\n") == b"[VER:1.1h.20190830:]\r\n[OPT:VH,15,128]\r\nok\r\n"


def test_somebody_elses_client_streams_a_job_and_the_stage_follows(require_module) -> None:
    pygrbl_streamer = require_module("pygrbl_streamer", "pygrbl-streamer")
    world = world_on(FastClock(40.0))
    emulator = GrblEmulator(world, travel_mm=(0.0, 100.0))
    # A saw tooth of 120 lines: far more than the controller's buffers hold, so that the client must count them.
    job = ["G21", "G90", *(f"G1 X{-10 - 5 * (n % 2)} F600 (line {n})" for n in range(120)), "G1 X-43.5 F600"]
    places_mm: list[float] = []
    with PtyServer(emulator) as wire:
        client = pygrbl_streamer.GrblStreamer(wire.address, auto_unlock=False)
        client.progress_callback = lambda percent, command: places_mm.append(world.stage_mm())  # noqa: ARG005
        client.connect()
        try:
            assert client.home(timeout=30.0, wait_idle=True)
            assert client.stream(job)
        finally:
            client.disconnect()
    assert world.stage_mm() == pytest.approx(42.5)  # one millimetre of pull-off lies before the rest position
    assert emulator.input.lost == 0
    assert max(places_mm) - min(places_mm) > 4.0
