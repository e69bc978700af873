"""A host that speaks just enough PTP/IP, written from CIPA DC-005 and PIMA 15740 and sharing nothing with the emulator."""

import socket
import struct


class Host:
    """Two connections to an emulated camera, and one request at a time."""

    def __init__(self, port: int, *, timeout_s: float = 60.0) -> None:
        self.commands = socket.create_connection(("127.0.0.1", port), timeout=timeout_s)
        self.events = socket.create_connection(("127.0.0.1", port), timeout=timeout_s)
        self._transaction = 0

    def __enter__(self) -> "Host":
        return self

    def __exit__(self, *_error: object) -> None:
        self.commands.close()
        self.events.close()

    def say_hello(self) -> str:
        """Open both connections as a host does; return the camera's name."""
        name = "a test".encode("utf-16-le") + b"\0\0"
        _send(self.commands, 1, bytes(16) + name + struct.pack("<HH", 0, 1))
        kind, payload = receive(self.commands)
        assert kind == 2
        (connection,) = struct.unpack_from("<I", payload)
        _send(self.events, 3, struct.pack("<I", connection))
        assert receive(self.events) == (4, b"")
        return payload[20:-6].decode("utf-16-le")

    def ask(self, operation: int, *parameters: int, data: bytes | None = None) -> tuple[int, bytes]:
        """Carry out one operation; return the response's code and the data that came."""
        self._transaction += 1
        phase = 1 if data is None else 2
        request = struct.pack("<IHI", phase, operation, self._transaction)
        _send(self.commands, 6, request + struct.pack(f"<{len(parameters)}I", *parameters))
        if data is not None:
            _send(self.commands, 9, struct.pack("<IQ", self._transaction, len(data)))
            _send(self.commands, 12, struct.pack("<I", self._transaction) + data)
        received = b""
        while True:
            kind, payload = receive(self.commands)
            if kind in (10, 12):
                received += payload[4:]
            if kind == 7:
                code, transaction = struct.unpack_from("<HI", payload)
                assert transaction == self._transaction
                return code, received

    def next_event(self) -> tuple[int, tuple[int, ...]]:
        """Wait for an event; return its code and parameters."""
        kind, payload = receive(self.events)
        assert kind == 8
        (code,) = struct.unpack_from("<H", payload)
        return code, struct.unpack_from(f"<{(len(payload) - 6) // 4}I", payload, 6)


def _send(connection: socket.socket, kind: int, payload: bytes) -> None:
    connection.sendall(struct.pack("<II", 8 + len(payload), kind) + payload)


def receive(connection: socket.socket) -> tuple[int, bytes]:
    """Return type and payload of the next packet; raises ``EOFError`` when the camera has hung up."""
    length, kind = struct.unpack("<II", _exactly(connection, 8))
    return kind, _exactly(connection, length - 8)


def _exactly(connection: socket.socket, count: int) -> bytes:
    parts = b""
    while len(parts) < count:
        part = connection.recv(count - len(parts))
        if not part:
            raise EOFError
        parts += part
    return parts
