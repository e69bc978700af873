"""How a New Era pump writes: two framings, replies, and numbers of four digits.

Sources: NE-1000 manual (publication 1200-01) pages 33 and 34, NE-9000 manual (1200-04) pages 40 to 42.
"""

import binascii
import re
from dataclasses import dataclass

from drivers.errors import DeviceProtocolError, OutOfVolumeError

STX, ETX = b"\x02", b"\x03"
# Length, check value and ETX are counted in the length of a Safe-mode packet; STX is not.
SAFE_EXTRA = 4
RUNNING_PROMPTS = {"I": "infusing", "W": "withdrawing", "X": "purging", "T": "in a timed pause", "U": "waiting"}
RESTING_PROMPTS = {"S": "stopped", "P": "paused"}
ALARMS = {
    "R": "it was reset: its power was interrupted",
    "S": "its motor stalled",
    "T": "no host spoke to it in time (Safe-mode time-out)",
    "E": "its pumping program has an error",
    "O": "its pumping program has a phase out of range",
}
REPLY = re.compile(r"(\d\d)(?:A\?([A-Z])|([A-Z]))(.*)", re.ASCII)
VALUE = re.compile(r"(\d*\.?\d*)([A-Z]*)", re.ASCII)


@dataclass(frozen=True, slots=True)
class Reply:
    """What the pump answered: its prompt, or the letter of an alarm, and the data that was asked for."""

    address: int
    prompt: str
    alarm: str
    data: str


def crc(data: bytes) -> int:
    """Return the check value of a Safe-mode packet: CRC-16/CCITT, polynomial 0x1021, started at 0 (page 34)."""
    return binascii.crc_hqx(data, 0)


def basic_packet(command: str) -> bytes:
    """Frame a command in Basic mode."""
    return command.encode("ascii") + b"\r"


def safe_packet(command: str) -> bytes:
    """Frame a command in Safe mode."""
    data = command.encode("ascii")
    return STX + bytes([len(data) + SAFE_EXTRA]) + data + crc(data).to_bytes(2, "big") + ETX


def parse_reply(data: bytes) -> Reply:
    """Read the data of a reply. Raises ``DeviceProtocolError`` for anything that the manual does not know."""
    text = data.decode("latin-1")
    match = REPLY.fullmatch(text)
    known = match is not None and (match[2] in ALARMS or match[3] in RUNNING_PROMPTS | RESTING_PROMPTS)
    if match is None or not known:
        raise DeviceProtocolError(
            f"pump: answered {text!r}, which is not in the manual of New Era pumps; check the make and the baud rate"
        )
    return Reply(int(match[1]), match[3] or "", match[2] or "", match[4])


def parse_value(text: str) -> tuple[float, str]:
    """Read ``500.0ML`` as 500.0 and ``ML``. Raises ``DeviceProtocolError`` for anything else."""
    match = VALUE.fullmatch(text)
    if match is None or not any(character.isdigit() for character in match[1]):
        raise DeviceProtocolError(f"pump: answered {text!r} where a number belongs; check the make of the pump")
    return float(match[1]), match[2]


def four_digits(value: float) -> str:
    """Write a number with at most four digits, at most three of them behind the point (page 33).

    Raises
    ------
    OutOfVolumeError
        When four digits cannot hold it, or hold nothing but zeros: to the pump a volume of 0 means without end.
    """
    for decimals in (3, 2, 1, 0):
        text = f"{value:.{decimals}f}"
        if len(text.replace(".", "")) <= 4:
            if float(text) <= 0:
                break
            return text
    raise OutOfVolumeError(f"pump: {value:g} cannot be sent to the pump, whose numbers go from 0.001 to 9999")
