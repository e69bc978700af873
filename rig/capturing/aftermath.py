"""What a session's journal says of how its last program ended: what was under way, and what is therefore not known.

Pure: journal lines in, facts out. What a sensor, a person or the ledger of the liquid knows besides is theirs to say.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

Ending = Literal["finished", "interrupted", "failed", "latched", "without a word"]

# The last line of a program that ended by itself; after any other it was killed, or the power went.
ENDINGS: dict[str, Ending] = {
    "capture_finished": "finished",
    "capture_interrupted": "interrupted",
    "capture_failed": "failed",
    "latched": "latched",
}
FINISHES = {
    "fill_stopped": "fill_started",
    "drain_stopped": "drain_started",
    "homing_finished": "homing_started",
    "move_finished": "move_started",
    "operator_answered": "operator_asked",
}
TANK_EVENTS = ("fill_started", "drain_started")
STAGE_EVENTS = ("homing_started", "move_started")
BY_HAND = ("fill_tank", "drain_tank")


@dataclass(frozen=True, slots=True)
class Aftermath:
    """How a session stands after its last line.

    Attributes
    ----------
    ending
        How the last program ended.
    under_way
        The intents, oldest first, whose end is not in the journal: each may have happened in full, in part or not at all.
    tank_ml
        What the tank held by the last line that tells; None where that is unknown.
    stage_mm
        Where the stage stood by the last line that tells; None where that is unknown.
    latch
        What a person has yet to look after; empty where nothing.
    """

    ending: Ending = "without a word"
    under_way: tuple[Mapping[str, Any], ...] = ()
    tank_ml: float | None = None
    stage_mm: float | None = None
    latch: str = ""

    @property
    def tank_is_unknown(self) -> bool:
        """Whether liquid may have moved since the last level that was taken down."""
        return self.tank_ml is None

    @property
    def stage_is_unknown(self) -> bool:
        """Whether the stage may stand anywhere."""
        return self.stage_mm is None


def aftermath(entries: Iterable[Mapping[str, Any]]) -> Aftermath:
    """Read a journal from its first line to its last.

    An intent without its end makes unknown what it was about, until a later line tells it again: an operator's or a
    sensor's level when a capture is resumed, a stage that was homed and moved.
    """
    after = Aftermath()
    for entry in entries:
        after = _after_entry(after, entry)
    return after


def _after_entry(before: Aftermath, entry: Mapping[str, Any]) -> Aftermath:
    event = entry["event"]
    after = replace(before, ending=ENDINGS.get(event, "without a word"))
    if event in FINISHES.values():
        after = replace(after, under_way=(*after.under_way, entry))
        if event in TANK_EVENTS or entry.get("request") in BY_HAND:
            after = replace(after, tank_ml=None)
        if event in STAGE_EVENTS:
            after = replace(after, stage_mm=None)
    elif event in FINISHES:
        started = FINISHES[event]
        after = replace(after, under_way=tuple(one for one in after.under_way if one["event"] != started))
        after = _told(after, entry)
    elif event in ("capture_started", "capture_resumed"):
        # A program that begins stops the pump, asks for the level and homes the stage: nothing is under way any more.
        after = _told(replace(after, under_way=(), stage_mm=None, tank_ml=None), entry)
    elif event == "latched":
        after = replace(after, latch=str(entry.get("text", "")) or "its cause is not in the journal")
    elif event == "unlatched":
        after = replace(after, latch="")
    return after


def _told(after: Aftermath, entry: Mapping[str, Any]) -> Aftermath:
    """Take over the level and the place that a line tells."""
    tank_ml, stage_mm = entry.get("tank_ml"), entry.get("stage_mm")
    if tank_ml is not None:
        after = replace(after, tank_ml=float(tank_ml))
    if stage_mm is not None:
        after = replace(after, stage_mm=float(stage_mm))
    return after


def aftermath_text(after: Aftermath) -> tuple[str, ...]:
    """Say it to a person, a line each; nothing where the last program ended in order."""
    lines = []
    if after.ending == "without a word":
        lines.append("the last program ended without a word: it was killed, or the power went")
    lines += [f"under way when it ended: {_intent_text(entry)}" for entry in after.under_way]
    unknown = [
        what
        for what, is_under_way in (
            ("what the tank holds", _concerns(after, TANK_EVENTS) or _asked(after, BY_HAND)),
            ("where the stage stands", _concerns(after, STAGE_EVENTS)),
            ("whether the object is in its place", _asked(after, ("insert_object", "remove_object"))),
        )
        if is_under_way
    ]
    if unknown:
        lines.append(f"not known from the journal: {', '.join(unknown)}")
    return tuple(lines)


def _concerns(after: Aftermath, events: tuple[str, ...]) -> bool:
    return any(entry["event"] in events for entry in after.under_way)


def _asked(after: Aftermath, requests: tuple[str, ...]) -> bool:
    return any(entry.get("request") in requests for entry in after.under_way)


def _intent_text(entry: Mapping[str, Any]) -> str:
    match entry["event"]:
        case "fill_started":
            return f"a fill of {entry['volume_ml']:.0f} ml"
        case "drain_started":
            return f"a drain of {entry['volume_ml']:.0f} ml"
        case "homing_started":
            return "the homing of the stage"
        case "move_started":
            return f"a move of the display to position {entry['position']} ({entry['to_mm']:g} mm)"
        case _:
            return f"a request to the operator ({entry['text']})"
