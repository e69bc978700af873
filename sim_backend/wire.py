"""Emulated devices on real ports: a pseudo terminal, a TCP port, or an RFC 2217 port with modem lines.

An emulator is an object that answers bytes with bytes; the classes here carry them, so that any program that opens a
serial port can talk to it. Every server listens on 127.0.0.1 only, serves one host at a time, and is a context manager.
"""

import contextlib
import os
import select
import socket
import threading
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
from typing import Any, Protocol, TypeVar, runtime_checkable

from sim_backend.line_faults import LineFaults

# How often an emulator is asked for what it says of its own accord.
POLL_S = 0.002
Server = TypeVar("Server", bound="WireServer")


@runtime_checkable
class Emulator(Protocol):
    """A device as its serial port sees it."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host, in any portions; return what the device answers at once."""
        ...

    def poll(self) -> bytes:
        """Return what the device says of its own accord, now that time has passed; called many times a second."""
        ...


class WireServer(ABC):
    """Carries bytes between an emulator and one host in a thread of its own.

    ``faults`` may be turned while it runs. An exception inside the emulator ends the service and is raised again on
    leaving, so that no test passes with a broken emulator.
    """

    def __init__(self, emulator: Emulator, *, faults: LineFaults | None = None) -> None:
        self.emulator = emulator
        self.faults = faults or LineFaults()
        self._leaving = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    @property
    @abstractmethod
    def address(self) -> str:
        """What a host opens: a device path or a URL that pyserial understands."""

    @property
    def is_serving(self) -> bool:
        """Whether the emulator is alive and answers."""
        return self._thread.is_alive()

    @abstractmethod
    def vanish(self) -> None:
        """Pull the cable: the host finds its port gone, and it does not come back."""

    @abstractmethod
    def _listen(self, timeout_s: float) -> bytes:
        """Wait for bytes from the host and return them; empty when none came."""

    @abstractmethod
    def _tell(self, data: bytes) -> None:
        """Send bytes to the host; they are lost when there is none."""

    def _run(self) -> None:
        try:
            while not self._leaving.is_set():
                heard = self.faults.to_device(self._listen(POLL_S))
                said = self.emulator.receive(heard) if heard else b""
                said = self.faults.to_host(said + self.emulator.poll())
                if said:
                    self._tell(said)
        except Exception as error:
            self._error = error
            self.vanish()

    def __enter__(self: Server) -> Server:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leaving.set()
        self._thread.join()
        self.vanish()
        if self._error is not None and kind is None:
            raise self._error


class PtyServer(WireServer):
    """An emulator on a pseudo terminal (POSIX). It has no modem lines, and nobody notices when a host opens it."""

    def __init__(self, emulator: Emulator, *, faults: LineFaults | None = None) -> None:
        super().__init__(emulator, faults=faults)
        # The host's end stays open here too: else each host that leaves would hang up the line for the next.
        self._device_end, self._host_end = os.openpty()
        tty.setraw(self._host_end)
        os.set_blocking(self._device_end, False)
        self._path = os.ttyname(self._host_end)
        self._open = True
        self._closing = threading.Lock()

    @property
    def address(self) -> str:
        """The path of the terminal that a host opens."""
        return self._path

    def vanish(self) -> None:
        """Close the terminal at both ends."""
        with self._closing:
            if self._open:
                self._open = False
                os.close(self._device_end)
                os.close(self._host_end)

    def _listen(self, timeout_s: float) -> bytes:
        with self._closing:
            if self._open and select.select([self._device_end], [], [], timeout_s)[0]:
                return os.read(self._device_end, 4096)
        if not self._open:
            self._leaving.wait(timeout_s)
        return b""

    def _tell(self, data: bytes) -> None:
        # A full terminal whose host reads nothing loses bytes, as a wire does.
        with self._closing, contextlib.suppress(BlockingIOError):
            if self._open:
                os.write(self._device_end, data)


class TcpServer(WireServer):
    """An emulator on a TCP port of this machine; ``on_connect`` may return what it says to each new host."""

    def __init__(
        self,
        emulator: Emulator,
        *,
        port: int = 0,
        faults: LineFaults | None = None,
        on_connect: Callable[[], bytes] | None = None,
    ) -> None:
        super().__init__(emulator, faults=faults)
        self._on_connect = on_connect
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port: int = self._listener.getsockname()[1]
        self._host: socket.socket | None = None

    @property
    def address(self) -> str:
        """The URL that pyserial opens."""
        return f"socket://127.0.0.1:{self.port}"

    def vanish(self) -> None:
        """Hang up and answer no more calls."""
        self._listener.close()
        self._hang_up()

    def _hang_up(self) -> None:
        host, self._host = self._host, None
        if host is not None:
            # A call that is shut down is noticed at the other end even while a thread here still waits on it.
            with contextlib.suppress(OSError):
                host.shutdown(socket.SHUT_RDWR)
            host.close()

    def _listen(self, timeout_s: float) -> bytes:
        host = self._host
        try:
            if host is None:
                if self._listener.fileno() < 0:
                    self._leaving.wait(timeout_s)
                elif select.select([self._listener], [], [], timeout_s)[0]:
                    self._answer(self._listener.accept()[0])
                return b""
            if not select.select([host], [], [], timeout_s)[0]:
                return b""
            data = host.recv(4096)
        except (OSError, ValueError):  # ValueError: closed by vanish() while select looked at it
            data = b""
        if not data:
            self._hang_up()
        return self._received(data)

    def _answer(self, host: socket.socket) -> None:
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._host = host
        if self._on_connect is not None:
            self._tell(self._on_connect())

    def _received(self, data: bytes) -> bytes:
        """Return the bytes meant for the device; a protocol around them unwraps them here."""
        return data

    def _tell(self, data: bytes) -> None:
        self._send(data)

    def _send(self, data: bytes) -> None:
        host = self._host
        if host is not None:
            with contextlib.suppress(OSError):
                host.sendall(data)


class PretendedModem:
    """The settings and modem lines of a serial port that is not there, as RFC 2217 sets and asks them."""

    def __init__(self, on_data_terminal_ready: Callable[[bool], None]) -> None:
        self.baudrate, self.bytesize, self.parity, self.stopbits = 9600, 8, "N", 1
        self.xonxoff = self.rtscts = self.dsrdtr = self.rts = self.break_condition = False
        self.cts = self.dsr = self.cd = True
        self.ri = False
        self._dtr = False
        self._on_data_terminal_ready = on_data_terminal_ready

    @property
    def dtr(self) -> bool:
        """The DTR wire."""
        return self._dtr

    @dtr.setter
    def dtr(self, on: bool) -> None:
        if on != self._dtr:
            self._dtr = on
            self._on_data_terminal_ready(on)

    def reset_input_buffer(self) -> None:
        """Nothing is buffered."""

    def reset_output_buffer(self) -> None:
        """Nothing is buffered."""


class Rfc2217Server(TcpServer):
    """An emulator behind a network port with modem lines: ``on_data_terminal_ready`` hears each change of DTR."""

    def __init__(
        self,
        emulator: Emulator,
        *,
        port: int = 0,
        faults: LineFaults | None = None,
        on_data_terminal_ready: Callable[[bool], None] = lambda on: None,  # noqa: ARG005
    ) -> None:
        super().__init__(emulator, port=port, faults=faults)
        self.modem = PretendedModem(on_data_terminal_ready)
        self._manager: Any = None

    @property
    def address(self) -> str:
        """The URL that pyserial opens."""
        return f"rfc2217://127.0.0.1:{self.port}"

    def write(self, data: bytes) -> None:
        """Send what the RFC 2217 negotiation says."""
        self._send(data)

    def _answer(self, host: socket.socket) -> None:
        from serial.rfc2217 import PortManager

        super()._answer(host)
        modem: Any = self.modem  # pyserial's types want a whole Serial where settings and lines are enough
        connection: Any = self
        self._manager = PortManager(modem, connection)

    def _received(self, data: bytes) -> bytes:
        if self._manager is None:
            return b""
        return b"".join(self._manager.filter(data))

    def _tell(self, data: bytes) -> None:
        if self._manager is not None:
            self._send(b"".join(self._manager.escape(data)))
