"""The side of PTP/IP that a camera has: one listening socket for both connections of a host.

The first connection of a session carries operations, the second events. Bytes go out as soon as they are written
(TCP_NODELAY), since every transaction is a conversation of small packets.
"""

import contextlib
import socket
import struct
import threading

from sim_backend.ptpip import packets
from sim_backend.ptpip.body import Body, LinkBrokenError, Reply, Request
from sim_backend.ptpip.packets import LinkClosedError, PacketType

GUID = b"refractive-scan\0"


class Responder:
    """Serves ``body`` on 127.0.0.1; ``port`` 0 takes a free one, and the attribute ``port`` says which."""

    def __init__(self, body: Body, *, port: int = 0) -> None:
        self._body = body
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port: int = self._listener.getsockname()[1]
        self._connections: set[socket.socket] = set()
        self._events: socket.socket | None = None
        self._sessions = 0
        self._lock = threading.Lock()
        body.tell = self._tell

    def serve(self) -> None:
        """Accept connections until :meth:`close`."""
        while True:
            try:
                connection, _address = self._listener.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._lock:
                self._connections.add(connection)
            threading.Thread(target=self._attend, args=(connection,), name="connection", daemon=True).start()

    def close(self) -> None:
        """Stop listening and break every connection."""
        self._listener.close()
        self.break_links()

    def replace_body(self, body: Body) -> None:
        """Serve another camera from now on, as after a change of cameras on the same cable."""
        self.break_links()
        self._body = body
        body.tell = self._tell

    def break_links(self) -> None:
        """Pull the cable: close every connection without a word."""
        with self._lock:
            connections, self._connections = self._connections, set()
            self._events = None
        for connection in connections:
            with contextlib.suppress(OSError):  # the host may have been quicker
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def _attend(self, connection: socket.socket) -> None:
        try:
            kind, _payload = packets.read_packet(connection)
            if kind == PacketType.INIT_COMMAND_REQUEST:
                self._attend_commands(connection)
            elif kind == PacketType.INIT_EVENT_REQUEST:
                self._attend_events(connection)
        except (LinkClosedError, OSError):
            pass  # the host went away, which is its right
        except LinkBrokenError:
            self.break_links()
        finally:
            with self._lock:
                self._connections.discard(connection)
            connection.close()

    def _send(self, connection: socket.socket, data: bytes) -> None:
        if not self._body.faults.silent:
            connection.sendall(data)

    def _attend_commands(self, connection: socket.socket) -> None:
        with self._lock:
            self._sessions += 1
            session = self._sessions
            self._body.close()
        self._send(connection, packets.init_command_ack(session, GUID, self._body.describe().model))
        try:
            while True:
                kind, payload = packets.read_packet(connection)
                if kind == PacketType.REQUEST:
                    self._attend_request(connection, payload)
        finally:
            with self._lock:
                if session == self._sessions:  # else the next host has come before this one was seen to be gone
                    self._body.close()

    def _attend_events(self, connection: socket.socket) -> None:
        with self._lock:  # what happens once the host knows that it listens must not go unheard
            self._send(connection, packets.packet(PacketType.INIT_EVENT_ACK))
            self._events = connection
        while True:
            packets.read_packet(connection)  # a host may send pings; nothing of it needs an answer

    def _attend_request(self, connection: socket.socket, payload: bytes) -> None:
        data_phase, operation, transaction = struct.unpack_from("<IHI", payload)
        parameters = struct.unpack_from(f"<{(len(payload) - 10) // 4}I", payload, 10)
        data = self._receive_data(connection) if data_phase == packets.DATA_FROM_HOST else b""
        if self._body.faults.silent:
            return
        reply: Reply = self._body.answer(Request(operation, parameters, data))
        if reply.data is not None:
            for part in packets.data_phase(transaction, reply.data):
                self._send(connection, part)
        self._send(connection, packets.response(reply.code, transaction, reply.parameters))

    def _receive_data(self, connection: socket.socket) -> bytes:
        data = bytearray()
        while True:
            kind, payload = packets.read_packet(connection)
            if kind in (PacketType.DATA, PacketType.END_DATA):
                data += payload[4:]
            if kind == PacketType.END_DATA:
                return bytes(data)

    def _tell(self, *told: tuple[int, tuple[int, ...]]) -> None:
        with self._lock:
            events = self._events
        if events is not None:
            with contextlib.suppress(OSError):  # nobody may listen any more
                self._send(events, b"".join(packets.event(code, 0, parameters) for code, parameters in told))
