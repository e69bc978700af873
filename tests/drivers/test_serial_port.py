"""The serial layer, against an echo on each kind of port and with each fault of a cable."""

import errno
import os
import threading
import time
from collections.abc import Callable

import pytest
from faults_page import OperatorReads

from drivers.errors import DeviceBusyError, DeviceNotFoundError, DeviceTimeoutError
from drivers.serial_port import SerialPort, deadline_after
from sim_backend.wire import PtyServer, Rfc2217Server, TcpServer, WireServer

SERVERS = {"pty": PtyServer, "tcp": TcpServer, "rfc2217": Rfc2217Server}
IN_TIME_S = 5.0
# pyserial 3.5 still starts its RFC 2217 thread the old way.
pytestmark = [
    pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:setName:DeprecationWarning"),
]
TOO_SOON_S = 0.05


class Echo:
    """Answers each line with the same line; says ``unasked`` once."""

    def __init__(self) -> None:
        self.unasked = b""

    def receive(self, data: bytes) -> bytes:
        return data

    def poll(self) -> bytes:
        said, self.unasked = self.unasked, b""
        return said


@pytest.fixture(params=SERVERS)
def server(request: pytest.FixtureRequest):
    with SERVERS[request.param](Echo()) as wire:
        yield wire


def open_port(wire: WireServer, **settings: object) -> SerialPort:
    return SerialPort(wire.address, baud=115200, device="stage", **settings)


def line(port: SerialPort) -> bytes:
    return port.read_until(b"\n", deadline_s=deadline_after(IN_TIME_S))


def wait_for(condition: Callable[[], bool]) -> None:
    deadline_s = deadline_after(IN_TIME_S)
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.002)


def test_lines_and_packets_of_every_byte_value_pass_unchanged(server: WireServer) -> None:
    everything = bytes(range(256))
    with open_port(server) as port:
        port.write(b"one\ntwo\n" + everything)
        assert line(port) == b"one\n"
        assert line(port) == b"two\n"
        assert port.read_exact(256, deadline_s=deadline_after(IN_TIME_S)) == everything


def test_a_silent_device_is_a_timeout_that_names_the_question_and_what_came(
    operator_reads: OperatorReads, server: WireServer
) -> None:
    server.faults.silent = True
    with open_port(server) as port:
        port.write(b"?")
        with operator_reads.raised(DeviceTimeoutError):
            port.read_until(b"\n", deadline_s=deadline_after(TOO_SOON_S), question="the status")
        server.faults.silent = False
        port.write(b"half")
        with operator_reads.raised(DeviceTimeoutError):
            port.read_until(b"\n", deadline_s=deadline_after(0.3))


def test_a_cable_that_is_pulled_out_is_told_apart_from_silence(server: WireServer) -> None:
    with open_port(server) as port:
        port.write(b"hello\n")
        line(port)
        server.vanish()

        def talk_on() -> None:
            for _ in range(1000):
                port.write(b"?")
                port.flush_input()

        with pytest.raises(DeviceNotFoundError, match=r"stage: .* has vanished; check the cable"):
            talk_on()


def test_a_cable_that_is_pulled_out_ends_a_wait_at_once(operator_reads: OperatorReads, server: WireServer) -> None:
    with open_port(server) as port:
        threading.Timer(0.05, server.vanish).start()
        started_s = time.monotonic()
        with operator_reads.raised(DeviceNotFoundError):
            port.read_until(b"\n", deadline_s=deadline_after(60.0))
        assert time.monotonic() - started_s < 10.0


def test_what_came_before_the_question_does_not_answer_it(server: WireServer) -> None:
    with open_port(server) as port:
        # A call waits in line until it is answered; what a device says to nobody is lost.
        port.write(b"hello\n")
        line(port)
        server.emulator.unasked = b"[stale]\nhalf a li"
        assert line(port) == b"[stale]\n"
        threading.Timer(0.05, setattr, (server.emulator, "unasked", b"ne\n")).start()
        assert port.resynchronise(quiet_s=0.5, deadline_s=deadline_after(IN_TIME_S)) == b"half a line\n"
        port.write(b"fresh\n")
        assert line(port) == b"fresh\n"


def test_noise_that_never_ends_does_not_hold_up_resynchronisation(server: WireServer) -> None:
    with open_port(server) as port:
        babbling = threading.Event()

        def babble() -> None:
            while not babbling.wait(0.002):
                server.faults.inject(b"\xff\x00")

        thread = threading.Thread(target=babble)
        thread.start()
        try:
            started_s = time.monotonic()
            # Each call must end by itself; which of them meets noise is for the machine's scheduler to say.
            wait_for(lambda: b"\xff\x00" in port.resynchronise(quiet_s=1.0, deadline_s=deadline_after(0.3)))
            wait_for(lambda: b"\xff\x00" in port.flush_input())
            assert time.monotonic() - started_s < 2 * IN_TIME_S
        finally:
            babbling.set()
            thread.join()


def test_lost_and_late_bytes_are_what_the_reader_sees(server: WireServer) -> None:
    with open_port(server) as port:
        server.faults.drop_to_host(2)
        port.write(b"abcd\n")
        assert line(port) == b"cd\n"
        server.faults.drop_to_device(1)
        port.write(b"abcd\n")
        assert line(port) == b"bcd\n"
        server.faults.delay_s = 0.2
        port.write(b"late\n")
        with pytest.raises(DeviceTimeoutError):
            port.read_until(b"\n", deadline_s=deadline_after(TOO_SOON_S))
        assert line(port) == b"late\n"


def test_every_line_is_traced_with_direction_and_a_time_that_never_runs_backwards(server: WireServer) -> None:
    passed: list[tuple[str, float, bytes]] = []
    with open_port(server, trace=lambda *entry: passed.append(entry)) as port:
        port.write(b"one\n")
        line(port)
        port.write(b"two\n")
        port.resynchronise(quiet_s=0.1, deadline_s=deadline_after(IN_TIME_S))
    assert [(direction, data) for direction, _, data in passed] == [
        ("sent", b"one\n"),
        ("received", b"one\n"),
        ("sent", b"two\n"),
        ("discarded", b"two\n"),
    ]
    assert [time_s for _, time_s, _ in passed] == sorted(time_s for _, time_s, _ in passed)


def test_a_terminal_without_modem_lines_says_so_and_goes_on() -> None:
    with PtyServer(Echo()) as wire, open_port(wire) as port:
        assert not port.set_data_terminal_ready(False)
        port.write(b"still here\n")
        assert line(port) == b"still here\n"


def test_the_modem_lines_of_a_network_port_reach_the_device() -> None:
    heard: list[bool] = []
    with Rfc2217Server(Echo(), on_data_terminal_ready=heard.append) as wire, open_port(wire) as port:
        assert port.set_data_terminal_ready(False)
        assert port.set_data_terminal_ready(True)
        wait_for(lambda: heard[-2:] == [False, True])


def test_a_port_that_another_program_holds_is_busy(operator_reads: OperatorReads) -> None:
    with (
        PtyServer(Echo()) as wire,
        open_port(wire),
        operator_reads.raised(DeviceBusyError),
    ):
        open_port(wire).open()


def test_a_port_can_be_closed_twice_and_opened_again(server: WireServer) -> None:
    port = open_port(server)
    for _ in range(2):
        with port:
            port.write(b"again\n")
            assert line(port) == b"again\n"
        port.close()
    with pytest.raises(DeviceNotFoundError, match="not open"):
        port.write(b"?")


@pytest.mark.parametrize(
    "address",
    [
        pytest.param("/dev/there-is-no-such-port", id="device"),
        pytest.param("socket://127.0.0.1:1", id="socket"),
        pytest.param("telepathy://stage", id="no address"),
    ],
)
def test_an_address_where_nothing_is_gets_one_sentence(operator_reads: OperatorReads, address: str) -> None:
    with operator_reads.raised(DeviceNotFoundError):
        SerialPort(address, baud=115200, device="stage").open()


def test_a_port_that_this_user_may_not_open_comes_with_the_command_that_lets_them(
    operator_reads: OperatorReads, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(path: str, *_: int) -> int:  # root may open everything
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)

    with PtyServer(Echo()) as wire:
        monkeypatch.setattr(os, "open", denied)
        with operator_reads.raised(DeviceNotFoundError):
            open_port(wire).open()


def test_a_stop_command_overtakes_a_thread_that_waits_for_an_answer() -> None:
    with PtyServer(Echo()) as wire, open_port(wire) as port:
        waiting = threading.Event()
        heard: list[bytes] = []

        def wait_for_answer() -> None:
            with port.transaction():
                waiting.set()
                heard.append(line(port))

        thread = threading.Thread(target=wait_for_answer)
        thread.start()
        assert waiting.wait(IN_TIME_S)
        port.write(b"stop\n")
        thread.join(IN_TIME_S)
        assert heard == [b"stop\n"]


def test_an_emulator_that_breaks_is_not_mistaken_for_a_device() -> None:
    class Broken(Echo):
        def receive(self, data: bytes) -> bytes:
            raise ZeroDivisionError(data)

    def serve_until_it_breaks() -> None:
        with PtyServer(Broken()) as wire, open_port(wire) as port:
            port.write(b"?")
            port.read_until(b"\n", deadline_s=deadline_after(IN_TIME_S))

    with pytest.raises(DeviceNotFoundError, match="vanished"):
        serve_until_it_breaks()

    def serve_until_it_ends() -> None:
        with PtyServer(Broken()) as wire:
            with open_port(wire) as port:
                port.write(b"?")
            wait_for(lambda: not wire.is_serving)

    with pytest.raises(ZeroDivisionError):
        serve_until_it_ends()
