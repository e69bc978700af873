"""The two framings of a New Era pump, as the pump sees them (NE-1000 manual, publication 1200-01, pages 33 and 34)."""

from dataclasses import dataclass

from drivers.protocols import Clock

STX, ETX, CR = 0x02, 0x03, 0x0D
# An incomplete packet is thrown away when its next byte takes longer than this (page 34).
INTER_BYTE_S = 0.5


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet from the host; ``data`` is None where its check value or its end is wrong."""

    data: bytes | None
    safe: bool


def ccitt_crc(data: bytes) -> int:
    """Return the 16-bit CCITT check value of page 34: polynomial 0x1021, started at 0, high bit first."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = ((value << 1) ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def pack_basic(reply: str) -> bytes:
    """Wrap a reply in Basic mode."""
    return bytes([STX]) + reply.encode("ascii") + bytes([ETX])


def pack_safe(reply: str) -> bytes:
    """Wrap a reply in Safe mode; the length counts every byte that follows STX."""
    data = reply.encode("ascii")
    return bytes([STX, len(data) + 4]) + data + ccitt_crc(data).to_bytes(2, "big") + bytes([ETX])


class PacketReader:
    """Collects bytes into packets; a line that begins with STX is a Safe-mode packet, in either mode."""

    def __init__(self, clock: Clock, *, inter_byte_s: float = INTER_BYTE_S) -> None:
        self._clock = clock
        self._inter_byte_s = inter_byte_s
        self._buffer = bytearray()
        self._last_s = clock.now_s()

    def clear(self) -> None:
        """Forget an incomplete packet."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[Packet]:
        """Take bytes and return the packets that they complete."""
        now_s = self._clock.now_s()
        if now_s - self._last_s > self._inter_byte_s:
            self._buffer.clear()
        self._last_s = now_s
        packets = []
        for byte in data:
            self._buffer.append(byte)
            packet = self._complete()
            if packet is not None:
                packets.append(packet)
                self._buffer.clear()
        return packets

    def _complete(self) -> Packet | None:
        buffer = self._buffer
        if buffer[0] != STX:
            return Packet(bytes(buffer[:-1]), safe=False) if buffer[-1] == CR else None
        if len(buffer) < 2 or len(buffer) < buffer[1] + 1:
            return None
        data = bytes(buffer[2:-3])
        sound = buffer[1] >= 4 and buffer[-1] == ETX and ccitt_crc(data) == int.from_bytes(buffer[-3:-1], "big")
        return Packet(data if sound else None, safe=True)
