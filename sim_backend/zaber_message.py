"""The frame of Zaber's ASCII protocol as a device sees it: commands in, replies out.

Source: Zaber ASCII protocol manual (zaber.com/wiki/ASCII), messages and checksums.
"""

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ZaberCommand:
    """One command: device and axis 0 mean all; ``id`` is echoed in the reply; ``words`` are empty for a status poll."""

    device: int
    axis: int
    id: str
    words: tuple[str, ...]
    has_checksum: bool


def checksum(text: bytes) -> bytes:
    """Return two hexadecimal digits: two's complement of the sum of ``text``, which lies after the first byte."""
    return b"%02X" % (-sum(text) & 0xFF)


def read_command(line: bytes) -> ZaberCommand | None:
    """Return the command in ``line``, or None where a device keeps silent: noise, or a checksum that does not fit."""
    start = line.rfind(b"/")
    if start < 0:
        return None
    body = line[start + 1 :].rstrip(b"\r\n")
    has_checksum = re.search(rb":[0-9A-Fa-f]{2}$", body) is not None
    if has_checksum:
        body, given = body[:-3], body[-2:]
        if checksum(body) != given.upper():
            return None
    words = body.decode("ascii", errors="replace").split()
    numbers: list[str] = []
    while words and len(numbers) < 3 and re.fullmatch(r"\d+|--", words[0]):
        numbers.append(words.pop(0))
    device, axis, identity = (*numbers, *("0", "0", "--")[len(numbers) :])
    if not (device.isdigit() and axis.isdigit()):
        return None
    return ZaberCommand(int(device), int(axis), identity, tuple(words), has_checksum)


def write_message(kind: str, body: str, *, with_checksum: bool) -> bytes:
    """Return a reply (``@``), an info (``#``) or an alert (``!``), framed for the wire."""
    data = body.encode("ascii")
    return kind.encode() + data + (b":" + checksum(data) if with_checksum else b"") + b"\r\n"
