"""A serial port with deadlines, a log of every line, and errors that say whether the cable or the device is at fault.

pyserial does the talking, so an address is anything that :func:`serial.serial_for_url` opens: a device path
(``/dev/ttyUSB0``, ``COM3``, the path of a pseudo terminal), ``socket://host:port`` or ``rfc2217://host:port``.
"""

import errno
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Literal

from drivers.errors import DeviceBusyError, DeviceNotFoundError, DeviceTimeoutError

if TYPE_CHECKING:
    import serial

Direction = Literal["sent", "received", "discarded"]
Trace = Callable[[Direction, float, bytes], None]

# How long one read waits before the deadline is looked at again.
READ_SLICE_S = 0.005
WRITE_TIMEOUT_S = 5.0
# What arrived before a question is read in a slice or two; a line that babbles longer than this is babbling for ever.
LONGEST_FLUSH_S = 0.2
# An answer that never ends is noise; no device here sends lines anywhere near as long.
LONGEST_ANSWER = 65536
# What the operating system says where a port has no such wire: a pseudo terminal, some USB adapters.
NO_MODEM_LINES = {errno.ENOTTY, errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP}

log = logging.getLogger(__name__)


def deadline_after(timeout_s: float) -> float:
    """Return the moment ``timeout_s`` from now on :func:`time.monotonic`, which no change of the wall clock moves."""
    return time.monotonic() + timeout_s


class SerialPort:
    """One port, one owner. Opened by :meth:`open` or ``with``; closing twice is harmless.

    Parameters
    ----------
    address
        Device path or URL, as pyserial opens it.
    baud
        Bits per second; 8 data bits, no parity, 1 stop bit, no flow control.
    device
        What hangs on the port, in the operator's words (``stage``, ``pump``): every message begins with it.
    trace
        Called with direction, :func:`time.monotonic` and the bytes of everything that passes.

    Notes
    -----
    ``transaction`` keeps a question and its answer together when several threads use the port. ``write`` alone does
    not wait for a transaction to end, so that a stop command overtakes a thread that waits for an answer. All deadlines
    are moments of :func:`time.monotonic`, see :func:`deadline_after`.
    """

    def __init__(self, address: str, *, baud: int, device: str, trace: Trace | None = None) -> None:
        self.address = address
        self.device = device
        self._baud = baud
        self._trace = trace
        self._port: serial.Serial | None = None
        self._pending = bytearray()
        self._transaction = threading.RLock()
        self._writing = threading.Lock()

    # Opening and closing

    def open(self) -> None:
        """Open the port for this program alone.

        Raises
        ------
        DeviceNotFoundError
            When there is no such port, or this user may not open it.
        DeviceBusyError
            When another program holds the port.
        """
        import serial

        try:
            self._port = serial.serial_for_url(
                self.address,
                baudrate=self._baud,
                timeout=READ_SLICE_S,
                # pyserial's RFC 2217 client knows no time limit for writing.
                write_timeout=None if "rfc2217://" in self.address else WRITE_TIMEOUT_S,
                exclusive=True,
            )
        except ValueError as error:
            raise DeviceNotFoundError(
                f"{self.device}: {self.address!r} is not the address of a port ({error}); "
                "write a device path, socket://host:port or rfc2217://host:port"
            ) from error
        except OSError as error:
            raise self._cannot_open(error) from error
        self._pending.clear()
        log.info("%s: opened %s at %d baud", self.device, self.address, self._baud)

    def _cannot_open(self, error: OSError) -> DeviceNotFoundError | DeviceBusyError:
        reason = str(error)
        if error.errno in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in reason:
            return DeviceBusyError(
                f"{self.device}: {self.address} is in use by another program; close it (cncjs, a serial monitor, "
                "another capture) and try again"
            )
        if error.errno == errno.EACCES or "Permission denied" in reason:
            return DeviceNotFoundError(
                f"{self.device}: this user may not open {self.address}; on Linux: sudo usermod -aG dialout $USER, "
                "then log in again"
            )
        return DeviceNotFoundError(
            f"{self.device}: nothing at {self.address} ({reason}); check cable, power and address{self._ports_found()}"
        )

    def _ports_found(self) -> str:
        if "://" in self.address:
            return ""
        from serial.tools import list_ports

        names = ", ".join(sorted(port.device for port in list_ports.comports()))
        return f"; this machine has the ports {names}" if names else "; this machine has no serial ports"

    def close(self) -> None:
        """Close the port; harmless when it is closed or has vanished."""
        port, self._port = self._port, None
        if port is None:
            return
        # pyserial forgets to close the socket of a connection that the other end has ended.
        connection = getattr(port, "_socket", None)
        try:
            port.close()
        except OSError as error:
            log.debug("%s: %s closed with %s", self.device, self.address, error)
        if connection is not None:
            connection.close()

    @property
    def is_open(self) -> bool:
        """Whether the port is open; a device that vanished leaves it open until it is next used."""
        return self._port is not None

    def __enter__(self) -> "SerialPort":
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Keep other threads' questions away until this one is answered; may be nested."""
        with self._transaction:
            yield

    # Talking

    def write(self, data: bytes) -> None:
        """Send ``data``. Raises ``DeviceNotFoundError`` when the port has vanished, ``DeviceTimeoutError`` when it blocks."""
        import serial

        port = self._opened()
        with self._writing, self._watched():
            try:
                port.write(data)
            except serial.SerialTimeoutException:
                raise DeviceTimeoutError(
                    f"{self.device}: {self.address} took no more bytes for {WRITE_TIMEOUT_S:g} s; "
                    "switch the device off and on"
                ) from None
        self._note("sent", data)

    def read_until(self, terminator: bytes, *, deadline_s: float, question: str = "an answer") -> bytes:
        """Return the bytes up to and with ``terminator``; what follows stays for the next read.

        Raises
        ------
        DeviceTimeoutError
            When the deadline passes first; the message names ``question`` and what came instead. Those bytes stay.
        DeviceNotFoundError
            When the port vanishes meanwhile.
        """
        while (end := self._pending.find(terminator)) < 0:
            if len(self._pending) > LONGEST_ANSWER:
                self.flush_input()
            self._receive(deadline_s, question=question)
        return self._take(end + len(terminator))

    def read_if_there(self, terminator: bytes) -> bytes | None:
        """Return the bytes up to and with ``terminator`` if they have come, else None after a few milliseconds."""
        if terminator not in self._pending:
            self._read_available()
        end = self._pending.find(terminator)
        return None if end < 0 else self._take(end + len(terminator))

    def read_exact(self, count: int, *, deadline_s: float, question: str = "an answer") -> bytes:
        """Return exactly ``count`` bytes; errors as for :meth:`read_until`."""
        while len(self._pending) < count:
            self._receive(deadline_s, question=question)
        return self._take(count)

    def flush_input(self) -> bytes:
        """Throw away what has arrived so far, so that the next answer belongs to the next question; return it.

        A line that never falls silent holds nobody up: it is read for ``LONGEST_FLUSH_S`` at most.
        """
        until_s = time.monotonic() + LONGEST_FLUSH_S
        while self._read_available() and time.monotonic() < until_s:
            pass
        return self._discard()

    def _discard(self) -> bytes:
        stale = bytes(self._pending)
        self._pending.clear()
        if stale:
            self._note("discarded", stale)
        return stale

    def resynchronise(self, *, quiet_s: float, deadline_s: float) -> bytes:
        """Throw away noise until nothing came for ``quiet_s``, or until the deadline; return it."""
        self._read_available()
        quiet_since_s = time.monotonic()
        while time.monotonic() < min(quiet_since_s + quiet_s, deadline_s):
            if self._read_available():
                quiet_since_s = time.monotonic()
        return self._discard()

    def set_data_terminal_ready(self, on: bool) -> bool:
        """Set the DTR wire; return False where the port has none (a pseudo terminal, a plain socket)."""
        port = self._opened()
        try:
            port.dtr = on
        except OSError as error:
            if error.errno in NO_MODEM_LINES:
                return False
            raise self._vanished(error) from error
        return "socket://" not in self.address

    # Inside

    def _opened(self) -> "serial.Serial":
        if self._port is None:
            raise DeviceNotFoundError(f"{self.device}: {self.address} is not open; open it before talking to it")
        return self._port

    def _receive(self, deadline_s: float, *, question: str) -> None:
        if self._read_available():
            return
        if time.monotonic() >= deadline_s:
            found = f"only {bytes(self._pending[-80:])!r} came" if self._pending else "nothing came"
            raise DeviceTimeoutError(
                f"{self.device}: waited for {question} on {self.address}, {found}; is it switched on, "
                f"is the baud rate {self._baud}?"
            )

    def _read_available(self) -> bool:
        """Wait one slice for bytes; tell whether any came."""
        port = self._opened()
        with self._watched():
            data = port.read(1)
            if data:
                data += port.read(port.in_waiting)
        self._pending += data
        return bool(data)

    def _take(self, count: int) -> bytes:
        data = bytes(self._pending[:count])
        del self._pending[:count]
        self._note("received", data)
        return data

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Turn whatever pyserial says when a device is pulled out into one sentence."""
        try:
            yield
        # A port that is closed by another thread leaves pyserial with None for a file number, hence TypeError.
        except (OSError, TypeError) as error:
            raise self._vanished(error) from error

    def _vanished(self, error: Exception) -> DeviceNotFoundError:
        log.info("%s: %s has vanished: %s", self.device, self.address, error)
        return DeviceNotFoundError(
            f"{self.device}: {self.address} has vanished; check the cable and the power, then start again"
        )

    def _note(self, direction: Direction, data: bytes) -> None:
        log.debug("%s: %s %r", self.device, direction, data)
        if self._trace is not None:
            self._trace(direction, time.monotonic(), data)
