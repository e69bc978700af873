"""What GRBL 1.1 says on the wire, and what it means for a person who stands beside the stage.

Sources: ``doc/markdown/interface.md``, ``settings.md`` and ``doc/csv/*.csv`` of gnea/grbl.
"""

import re
from dataclasses import dataclass

SOFT_RESET, STATUS, FEED_HOLD, CANCEL_JOG = b"\x18", b"?", b"!", b"\x85"

# What stopped the controller, and what the operator does about it.
ALARMS = {
    1: "a limit switch was hit and the position is lost; free the carriage, then home the stage",
    2: "a move would have left the travel; check travel_mm against $130, then home the stage",
    3: "it was reset while it moved and the position is lost; home the stage",
    6: "it was reset while homing; home the stage again",
    7: "the safety door opened while homing; close it and home the stage again",
    8: "the carriage did not come free of the homing switch; check the switch and $27, then home the stage",
    9: "the homing switch was not found; check the switch, its wiring, $23 and $25; a stage with one axis needs a "
    "firmware that homes X alone (HOMING_SINGLE_AXIS_COMMANDS), since the default build homes Z first",
    10: "the second motor of an axis did not find its switch; check both switches, then home the stage",
}
ERRORS = {
    5: "homing is switched off; send $22=1 once with a terminal program",
    8: "it is not idle; wait, or home the stage if it is in alarm",
    9: "it is locked after an alarm; home the stage",
    10: "soft limits need homing; send $22=1",
    12: "$110 is faster than it can make steps; lower $110",
    13: "its safety door is open; close it, then home the stage",
    15: "the target lies outside $130 of the controller; check travel_mm against $130 and $27",
}
# Complaints about the writing of a line. The driver writes none that is wrong, so these were changed on the wire.
GARBLED = frozenset({1, 2, 3, 4, 11, 16, *range(20, 39)})
GARBLED_REASON = "the line arrived garbled; check cable and shielding"
# States in which a move neither goes on nor begins, and what ends them.
STANDSTILLS = {
    "Hold": "somebody pressed its feed hold; home the stage",
    "Door": "its safety door is open; close it, then home the stage",
    "Sleep": "somebody sent it to sleep ($SLP); home the stage",
    "Check": "another program left it in its check mode ($C); home the stage",
}


@dataclass(frozen=True, slots=True)
class GrblStatus:
    """One status report: machine or work coordinates, and the work offset where the report holds it."""

    state: str
    place: tuple[float, ...]
    is_machine: bool
    offset: tuple[float, ...] | None


def read_status(line: str) -> GrblStatus | None:
    """Return the report in ``line``, or None; what noise put before it does not matter."""
    match = re.search(r"<([A-Z][a-z]+)(?::\d)?\|(.*)>$", line)
    if match is None:
        return None
    fields = dict(part.split(":", 1) for part in match[2].split("|") if ":" in part)
    place = _numbers(fields.get("MPos", fields.get("WPos", "")))
    if not place:
        return None
    return GrblStatus(match[1], place, "MPos" in fields, _numbers(fields.get("WCO", "")) or None)


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        return ()


def read_code(line: str, *, word: str) -> int | None:
    """Return N of ``error:N`` or ``ALARM:N``, or None for another line."""
    match = re.search(rf"{word}:(\d+)$", line)
    return int(match[1]) if match else None


def reason_of(code: int) -> str:
    """Say why a line was answered with ``error:N``, and what to do."""
    if code in GARBLED:
        return GARBLED_REASON
    return ERRORS.get(code, "see error_codes_en_US.csv of GRBL")


def is_banner(line: str) -> bool:
    """Tell whether the controller has just started (GRBL, grblHAL and FluidNC all begin like this)."""
    return re.search(r"Grbl\w* \d+\.\d+", line) is not None
