"""The ledger of the liquid: what tank and reservoir hold, each known or unknown, and how and when that was learnt.

Pure data and pure functions: a ledger is what its events make of it (:func:`after`), and :mod:`rig.tank.ledger_book` keeps the
events. *Unknown* is a state like any other: it begins with the intent to pump and ends with a count, a measurement or
somebody's word, so that whatever happens in between leaves behind what is true, that nobody knows.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from functools import cache
from typing import Any, Literal

from pydantic import TypeAdapter

from drivers.protocols import FlowDirection
from rig.errors import LedgerError

How = Literal["measured", "counted", "told"]
Vessel = Literal["tank", "reservoir"]
Destination = Literal["vessel", "cylinder"]


@dataclass(frozen=True, slots=True)
class Known:
    """What a vessel holds: a sensor has measured it, the pump has counted it, or a person has told it."""

    ml: float
    how: How
    when: str  # ISO 8601, as in a journal


@dataclass(frozen=True, slots=True)
class Unknown:
    """Nobody knows what a vessel holds, and why."""

    why: str


Level = Known | Unknown


@dataclass(frozen=True, slots=True)
class FlowBegun:
    """The intent to pump, noted before the pump turns. Into a ``cylinder``: the far end of the hose is held into one."""

    direction: FlowDirection
    volume_ml: float
    into: Destination = "vessel"


@dataclass(frozen=True, slots=True)
class FlowEnded:
    """The pump stands, nothing went wrong, and it counted this much."""

    moved_ml: float


@dataclass(frozen=True, slots=True)
class FlowBroken:
    """The flow did not end as it should; how much has moved is not known."""

    why: str


@dataclass(frozen=True, slots=True)
class LevelLearnt:
    """A sensor has measured a vessel, or a person has told what it holds."""

    vessel: Vessel
    ml: float
    how: How


Event = FlowBegun | FlowEnded | FlowBroken | LevelLearnt
KINDS: dict[str, type[Event]] = {
    "flow_begun": FlowBegun,
    "flow_ended": FlowEnded,
    "flow_broken": FlowBroken,
    "level_learnt": LevelLearnt,
}


@dataclass(frozen=True, slots=True)
class OpenFlow:
    """A flow whose end is not on record yet, and what the vessels held before it."""

    begun: FlowBegun
    tank: Level
    reservoir: Level


@dataclass(frozen=True, slots=True)
class Ledger:
    """What is where. ``total_ml`` is the liquid in both vessels together; while ``open_flow`` is set the pump may turn."""

    total_ml: float
    tank: Level
    reservoir: Level
    open_flow: OpenFlow | None = None


def new_ledger(*, total_ml: float) -> Ledger:
    """Return the ledger of a rig of which nobody has said anything yet but how much liquid it has."""
    never = Unknown("nobody has said yet")
    return Ledger(total_ml, never, never)


def after(ledger: Ledger, event: Event, *, when: str) -> Ledger:
    """Return the ledger after ``event``, which happened at ``when`` (ISO 8601)."""
    match event:
        case FlowBegun():
            open_flow = OpenFlow(event, ledger.tank, ledger.reservoir)
            doubt = Unknown(
                f"a {event.direction} of {event.volume_ml:.0f} ml began {_clock(when)} and has no end on record"
            )
            return replace(ledger, tank=doubt, reservoir=doubt, open_flow=open_flow)
        case FlowEnded():
            return _counted(ledger, event.moved_ml, when=when)
        case FlowBroken():
            doubt = Unknown(event.why)
            return replace(ledger, tank=doubt, reservoir=doubt, open_flow=None)
        case LevelLearnt():
            return _learnt(ledger, event, when=when)


def _counted(ledger: Ledger, moved_ml: float, *, when: str) -> Ledger:
    flow = ledger.open_flow
    if flow is None:
        return ledger
    drains = flow.begun.direction == "drain"
    source, target = ("tank", "reservoir") if drains else ("reservoir", "tank")
    held: dict[str, Level] = {"tank": flow.tank, "reservoir": flow.reservoir}
    if drains and isinstance(flow.tank, Known):
        moved_ml = min(moved_ml, flow.tank.ml)  # a pump also counts when it draws air
    held[source] = _changed(held[source], -moved_ml, when=when)
    total_ml = ledger.total_ml
    if flow.begun.into == "vessel":
        held[target] = _changed(held[target], moved_ml, when=when)
    else:
        total_ml -= moved_ml
    return Ledger(total_ml, held["tank"], held["reservoir"])


def _changed(level: Level, by_ml: float, *, when: str) -> Level:
    return level if isinstance(level, Unknown) else Known(max(0.0, level.ml + by_ml), "counted", when)


def _learnt(ledger: Ledger, event: LevelLearnt, *, when: str) -> Ledger:
    """Liquid is neither made nor lost: what is not in the tank is in the reservoir. Who refills one vessel says so."""
    level = Known(event.ml, event.how, when)
    if event.vessel == "tank":
        reservoir = Known(max(0.0, ledger.total_ml - event.ml), "counted", when)
        return Ledger(ledger.total_ml, tank=level, reservoir=reservoir)
    total_ml = ledger.tank.ml + event.ml if isinstance(ledger.tank, Known) else ledger.total_ml
    return replace(ledger, reservoir=level, total_ml=total_ml)


# Words and lines


def level_text(level: Level, *, limit_ml: float | None = None) -> str:
    """Say a level, of how much there may be, and how it is known, in words."""
    if isinstance(level, Unknown):
        return f"unknown: {level.why}"
    limit = "" if limit_ml is None else f" of {limit_ml:.0f} ml"
    return f"{level.ml:.0f} ml{limit} ({level.how} {_clock(level.when)})"


def _clock(when: str) -> str:
    return datetime.fromisoformat(when).astimezone().strftime("at %H:%M on %Y-%m-%d")


def known_ml(level: Level) -> float | None:
    """Return what a vessel holds, None while nobody knows."""
    return level.ml if isinstance(level, Known) else None


def entry_of(event: Event) -> tuple[str, dict[str, Any]]:
    """Return the name and the fields of the line that keeps ``event``."""
    name = next(name for name, kind in KINDS.items() if isinstance(event, kind))
    return name, asdict(event)


@cache
def _adapter(name: str) -> TypeAdapter[Any]:
    return TypeAdapter(KINDS[name])


def event_of(entry: Mapping[str, Any]) -> Event:
    """Return the event that a line keeps; raises ``LedgerError`` for a line that keeps none."""
    fields = {name: value for name, value in entry.items() if name not in ("event", "time")}
    try:
        datetime.fromisoformat(entry["time"])
        event: Event = _adapter(entry["event"]).validate_python(fields)
    except (KeyError, TypeError, ValueError):
        raise LedgerError(f"{dict(entry)!r} is no event of a ledger") from None
    return event
