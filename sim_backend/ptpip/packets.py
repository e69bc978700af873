"""PTP/IP packets: ``u32 length, u32 type, payload``, all little endian (CIPA DC-005, sections 2 and 3).

The length counts its own eight bytes of header. A transaction is a request, up to one data phase (start, data packets,
end), and a response; events travel on a second connection of the same session.
"""

import socket
import struct
from collections.abc import Iterator
from enum import IntEnum

HEADER = struct.Struct("<II")
# No packet of a host comes near this; a longer one is a peer that speaks something else.
LONGEST_PACKET = 64 * 1024 * 1024
DATA_BLOCK = 1024 * 1024
PROTOCOL_VERSION = 0x0001_0000
DATA_FROM_HOST = 2


class PacketType(IntEnum):
    """What a packet is."""

    INIT_COMMAND_REQUEST = 1
    INIT_COMMAND_ACK = 2
    INIT_EVENT_REQUEST = 3
    INIT_EVENT_ACK = 4
    INIT_FAIL = 5
    REQUEST = 6
    RESPONSE = 7
    EVENT = 8
    START_DATA = 9
    DATA = 10
    CANCEL = 11
    END_DATA = 12
    PING = 13
    PONG = 14


class LinkClosedError(Exception):
    """The peer closed the connection, or said something that is no PTP/IP."""


def packet(kind: PacketType, payload: bytes = b"") -> bytes:
    """Return one packet."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def read_packet(connection: socket.socket) -> tuple[int, bytes]:
    """Return type and payload of the next packet; raises :class:`LinkClosedError` at the end of the stream."""
    length, kind = HEADER.unpack(_read_exactly(connection, HEADER.size))
    if not HEADER.size <= length <= LONGEST_PACKET:
        raise LinkClosedError(f"a packet of {length} bytes")
    return kind, _read_exactly(connection, length - HEADER.size)


def _read_exactly(connection: socket.socket, count: int) -> bytes:
    parts = bytearray()
    while len(parts) < count:
        try:
            part = connection.recv(count - len(parts))
        except OSError as error:
            raise LinkClosedError(str(error)) from error
        if not part:
            raise LinkClosedError("end of stream")
        parts += part
    return bytes(parts)


def response(code: int, transaction: int, parameters: tuple[int, ...] = ()) -> bytes:
    """Return the packet that ends a transaction."""
    return packet(PacketType.RESPONSE, struct.pack(f"<HI{len(parameters)}I", code, transaction, *parameters))


def event(code: int, transaction: int, parameters: tuple[int, ...] = ()) -> bytes:
    """Return an event packet, which carries up to three parameters."""
    return packet(PacketType.EVENT, struct.pack(f"<HI{len(parameters)}I", code, transaction, *parameters))


def data_phase(transaction: int, data: bytes) -> Iterator[bytes]:
    """Yield the packets that carry ``data`` to the host."""
    yield packet(PacketType.START_DATA, struct.pack("<IQ", transaction, len(data)))
    blocks = range(0, len(data), DATA_BLOCK) or range(1)
    for start in blocks:
        kind = PacketType.END_DATA if start == blocks[-1] else PacketType.DATA
        yield packet(kind, struct.pack("<I", transaction) + data[start : start + DATA_BLOCK])


def init_command_ack(connection_number: int, guid: bytes, name: str) -> bytes:
    """Return the answer to a host that opens the command connection."""
    label = name.encode("utf-16-le") + b"\0\0"
    return packet(
        PacketType.INIT_COMMAND_ACK,
        struct.pack("<I", connection_number) + guid + label + struct.pack("<I", PROTOCOL_VERSION),
    )
