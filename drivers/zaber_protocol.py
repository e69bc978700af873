"""Zaber's ASCII protocol on the wire, and what its warning flags mean for a person who stands beside the stage.

Sources: Zaber ASCII protocol manual (zaber.com/wiki/ASCII: messages, checksum, warning flags, reject reasons).
"""

import re
from dataclasses import dataclass
from typing import Literal

# A flag that is set when a movement ends means that it failed, even if the device is idle again.
FAULTS = {
    "FF": "a critical system error; switch it off and on, and if it comes back, ask Zaber",
    "FN": "the connected stage is not supported by this controller; check that the two belong together",
    "FZ": "the axis is switched off in the controller; activate it with Zaber's own program",
    "FH": "the emergency stop is pressed; release it, then home the stage",
    "FV": "its supply voltage is out of range; check the power supply",
    "FO": "its driver is switched off; switch the device off and on, then home the stage",
    "FD": "its driver switched itself off; check load and supply, switch it off and on, then home the stage",
    "FC": "too much current on switching on; check the supply, then switch it off and on",
    "FM": "the motor is too hot; let it cool, and look for friction",
    "FQ": "the encoder cannot be trusted; check its cable, then home the stage",
    "FI": "the index of the encoder was not found; home the stage",
    "FA": "the analogue encoder lost its signal; check its cable, then home the stage",
    "FR": "the driver was overloaded; look for friction",
    "FS": "it stalled and stopped; look for an obstacle, then home the stage",
    "FB": "a stream left its bounds; let no other program talk to it, then home the stage",
    "FP": "it left its path; look for an obstacle, then home the stage",
    "FE": "a limit switch cannot be trusted; check it, then home the stage",
    "FT": "the cables are twisted too far; untwist them, then home the stage",
    "WL": "a limit switch was hit where none was expected; look for an obstacle, then home the stage",
    "WM": "it was pushed out of its place while it stood; photos since its last move are not to be trusted. Home the stage",
    "NI": "the movement was interrupted by another command or by its knob; move again",
    "NC": "somebody turned its knob; home the stage",
}
# These leave the position as good as it was.
CONCERNS = {
    "WS": "it stalled and recovered; look for friction",
    "WV": "its supply voltage is out of range; check the power supply",
    "WT": "its controller is hot; give it air",
}
NOT_HOMED = {
    "WR": "it does not know where it is",
    "WH": "it was not homed since it was switched on",
}
REJECTIONS = {
    "AGAIN": "it cannot answer now; wait a moment, then try again",
    "BADDATA": "the value lies outside what it accepts; check travel_mm against limit.max",
    "BADCOMMAND": "it does not know the command; check that this is a stage with the ASCII protocol",
    "BADAXIS": "it has no such axis; check that this is a stage of one axis",
    "STATUSBUSY": "it is moving; wait until it stands, then try again",
    "FULL": "too many commands wait in it; let no other program talk to it",
    "DRIVERDISABLED": "its driver is switched off; switch the device off and on, then home the stage",
    "PARKED": "it is parked; unpark it with Zaber's own program, then home the stage",
    "LOCKSTEP": "the axis is coupled to another one (lockstep); uncouple it with Zaber's own program",
}


@dataclass(frozen=True, slots=True)
class ZaberMessage:
    """One message from a device. ``kind``: ``@`` reply, ``!`` alert, ``#`` info. Only replies have a verdict and an id."""

    kind: Literal["@", "!", "#"]
    device: int
    axis: int
    id: str = ""
    accepted: bool = True
    busy: bool = False
    flag: str = "--"
    data: str = ""


def checksum(text: bytes) -> bytes:
    """Return two upper-case hexadecimal digits: two's complement of the byte sum of ``text``.

    ``text`` is everything between a message's first byte and the colon.

    Examples
    --------
    >>> checksum(b"1 0 00 get pos")
    b'2D'
    """
    return b"%02X" % (-sum(text) & 0xFF)


def write_command(words: str, *, device: int, axis: int, message_id: int) -> bytes:
    """Return a command with id and checksum; empty ``words`` ask for the status.

    Examples
    --------
    >>> write_command("move abs 5000", device=1, axis=1, message_id=10)
    b'/1 1 10 move abs 5000:EB\\n'
    """
    body = f"{device} {axis} {message_id:02d} {words}".rstrip().encode("ascii")
    return b"/" + body + b":" + checksum(body) + b"\n"


def read_message(line: bytes) -> ZaberMessage | None:
    """Return the message in ``line``; None for noise and for a checksum that does not fit. What precedes it is noise."""
    start = max(line.rfind(kind) for kind in (b"@", b"!", b"#"))
    if start < 0:
        return None
    kind, body = chr(line[start]), line[start + 1 :].rstrip(b"\r\n")
    if re.search(rb":[0-9A-Fa-f]{2}$", body):
        if checksum(body[:-3]) != body[-2:].upper():
            return None
        body = body[:-3]
    text = body.decode("ascii", errors="replace")
    if kind == "@":
        return _read_reply(text)
    match = re.fullmatch(r"(\d+) (\d+) ?(.*)", text)
    if match is None:
        return None
    return ZaberMessage("!" if kind == "!" else "#", int(match[1]), int(match[2]), data=match[3])


def _read_reply(text: str) -> ZaberMessage | None:
    match = re.fullmatch(r"(\d+) (\d+) (?:(\d+|--) )?(OK|RJ) (BUSY|IDLE) (\S\S)(?: (.*))?", text)
    if match is None:
        return None
    device, axis, identity, verdict, state, flag, data = match.groups(default="")
    return ZaberMessage("@", int(device), int(axis), identity, verdict == "OK", state == "BUSY", flag, data)


def read_flags(data: str) -> set[str]:
    """Return the flags in the answer to ``warnings``: a count, then the flags."""
    return set(data.split()[1:])
