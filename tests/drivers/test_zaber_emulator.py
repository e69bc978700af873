"""The emulated Zaber stage against the manual, and against Zaber's own library over a terminal and over TCP."""

import threading
import time

import numpy as np
import pytest

from drivers.protocols import Frame
from sim_backend.clock import FastClock, SimulatedClock
from sim_backend.wire import PtyServer, TcpServer, WireServer
from sim_backend.world import TankSize, World, WorldState
from sim_backend.zaber_emulator import ZaberEmulator

# A round number: 10 mm are 10 000 microsteps.
MICROSTEP_MM = 0.001


def emulator_on(clock: SimulatedClock | FastClock) -> tuple[ZaberEmulator, World]:
    dark = Frame(axis="x", levels=np.zeros(8, np.uint8))
    world = World(clock=clock, tank=TankSize(1.0, 1.0), dark_frame=dark, state=WorldState(stage_mm=37.0))
    emulator = ZaberEmulator(world, travel_mm=(0.0, 100.0), microstep_mm=MICROSTEP_MM, velocity_mm_per_s=10.0)
    return emulator, world


def test_replies_have_the_frame_and_the_checksum_of_the_manual() -> None:
    emulator, world = emulator_on(SimulatedClock())
    assert emulator.receive(b"/1 0 00 get pos:2D\n") == b"@01 0 00 OK IDLE WR 0:BE\r\n"
    assert emulator.receive(b"/1 1 02 ho") == b""
    assert emulator.receive(b"me:33\r\n").startswith(b"@01 1 02 OK BUSY WR 0:")
    world.clock.sleep_s(3.7)
    assert emulator.receive(b"/1 1\n") == b"@01 1 OK IDLE -- 0\r\n"
    assert emulator.receive(b"/warnings\n") == b"@01 0 OK IDLE -- 00\r\n"


def test_what_is_not_meant_for_the_device_gets_no_answer() -> None:
    emulator, _ = emulator_on(SimulatedClock())
    assert emulator.receive(b"/2 get pos\n") == b""
    assert emulator.receive(b"/1 0 00 get pos:2E\n") == b""  # a checksum that does not fit
    assert emulator.receive(b"\xffnoise\n") == b""
    assert emulator.receive(b"\xff/1 get pos\n") == b"@01 0 OK IDLE WR 0\r\n"


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("dance", "BADCOMMAND"),
        ("get colour", "BADCOMMAND"),
        ("move abs 100001", "BADDATA"),
        ("move abs -1", "BADDATA"),
        ("move abs far", "BADDATA"),
        ("set maxspeed 0", "BADDATA"),
    ],
)
def test_what_it_does_not_accept_is_rejected_with_the_reason(words: str, reason: str) -> None:
    emulator, world = emulator_on(SimulatedClock())
    assert emulator.receive(f"/1 1 {words}\n".encode()) == f"@01 1 RJ IDLE WR {reason}\r\n".encode()
    assert not world.is_moving()


def test_the_most_serious_flag_is_shown_and_warnings_lists_them_all() -> None:
    emulator, world = emulator_on(SimulatedClock())
    emulator.receive(b"/1 move abs 50000\n")
    world.clock.sleep_s(1.0)
    emulator.receive(b"/1 stop\n")
    emulator.fail("FS")
    assert emulator.receive(b"/1\n") == b"@01 0 OK IDLE FS 0\r\n"
    assert emulator.receive(b"/1 warnings clear\n") == b"@01 0 OK IDLE WR 03 FS WR NI\r\n"
    assert emulator.receive(b"/1 warnings\n") == b"@01 0 OK IDLE WR 01 WR\r\n"


@pytest.fixture(params=["terminal", "TCP"])
def library_on_wire(request: pytest.FixtureRequest, require_module):
    """Zaber's library, opened on the emulator: the axis, the emulator, its world and its wire."""
    ascii_ = require_module("zaber_motion.ascii", "zaber-motion")
    emulator, world = emulator_on(FastClock(20.0))
    server: type[WireServer] = PtyServer if request.param == "terminal" else TcpServer
    with server(emulator) as wire:
        if isinstance(wire, TcpServer):
            connection = ascii_.Connection.open_tcp("127.0.0.1", wire.port)
        else:
            connection = ascii_.Connection.open_serial_port(wire.address)
        with connection:
            connection.checksum_enabled = True
            yield connection.get_device(1).get_axis(1), emulator, world, connection


def test_zabers_library_homes_and_moves_it(library_on_wire) -> None:
    axis, _, world, _ = library_on_wire
    assert not axis.is_homed()
    axis.home()
    assert axis.is_homed()
    assert world.stage_mm() == pytest.approx(0.0)
    axis.move_absolute(42_500)
    assert axis.get_position() == 42_500
    assert world.stage_mm() == pytest.approx(42.5)
    axis.move_relative(-2_500)
    assert world.stage_mm() == pytest.approx(40.0)
    axis.move_max()
    assert world.stage_mm() == pytest.approx(100.0)
    assert axis.settings.get("maxspeed") == 16384  # 10 000 microsteps a second
    assert axis.warnings.get_flags() == set()


def test_zabers_library_sees_stalls_interruptions_and_rejections(library_on_wire) -> None:
    import zaber_motion

    axis, emulator, world, connection = library_on_wire
    axis.home()
    axis.move_absolute(90_000, wait_until_idle=False)
    emulator.fail("FS")
    with pytest.raises(zaber_motion.MovementFailedException):
        axis.wait_until_idle()

    def another_program() -> None:
        while not world.is_moving():
            time.sleep(0.001)
        emulator.receive(b"/1 1 stop\n")

    threading.Thread(target=another_program, daemon=True).start()
    with pytest.raises(zaber_motion.MovementInterruptedException):
        axis.move_absolute(90_000)
    with pytest.raises(zaber_motion.CommandFailedException, match="BADDATA"):
        axis.move_absolute(200_000)
    assert connection.generic_command("tools echo hello", device=1).data == "hello"
    assert not world.is_moving()
