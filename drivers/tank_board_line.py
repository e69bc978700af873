"""The lines of a tank board's protocol (``docs/how-to/build-a-pump-board.md``)."""

import re
from dataclasses import dataclass

from drivers.protocols import FlowDirection

VERBS: dict[FlowDirection, str] = {"fill": "FILL", "drain": "DRAIN"}
DIRECTION_OF: dict[str, FlowDirection] = {"FILLING": "fill", "DRAINING": "drain"}
FAULTS = {
    "reset": "the board was reset: its power was interrupted",
    "heartbeat": "nobody asked for the board's status for a second, so it stopped the pump",
    "leak": "the leak contact is open: there is liquid beside the tank, or its wire is broken",
    "full": "the over-fill contact is open: the tank is full, or its wire is broken",
}
REPLY = re.compile(
    r"(?:OK|NO) (?P<verb>\S+) (?P<state>IDLE|FILLING|DRAINING) ran=(?P<ran>\d+) left=(?P<left>\d+) "
    r"fault=(?P<fault>none|reset|heartbeat|leak|full) leak=(?P<leak>[01]) full=(?P<full>[01]) level=(?P<level>\d+)"
    r"(?: why=(?P<why>\w+))?(?: id=(?P<id>\S+))?",
    re.ASCII,
)


@dataclass(frozen=True, slots=True)
class BoardState:
    """One reply: which line it answers, and everything about the board at that moment. ``why`` is set on a refusal."""

    verb: str
    direction: FlowDirection | None
    ran_ms: int
    left_ms: int
    fault: str
    leak_open: bool
    full_open: bool
    level: int
    why: str
    identity: str
    text: str


def parse_line(line: bytes) -> BoardState | None:
    """Read one reply; None for anything else, such as what a board says while it is reset in mid-line."""
    text = line.decode("latin-1").strip()
    match = REPLY.fullmatch(text)
    if match is None:
        return None
    return BoardState(
        verb=match["verb"],
        direction=DIRECTION_OF.get(match["state"]),
        ran_ms=int(match["ran"]),
        left_ms=int(match["left"]),
        fault=match["fault"],
        leak_open=match["leak"] == "1",
        full_open=match["full"] == "1",
        level=int(match["level"]),
        why=match["why"] or "",
        identity=match["id"] or "",
        text=text,
    )
