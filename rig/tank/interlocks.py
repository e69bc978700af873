"""What the rig must not do, and when: one table of interlocks, for the capture and for the commands by hand.

Pure data and a pure function. :mod:`rig.tank.guard` asks the devices and refuses; the page on safety prints the table.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from drivers.protocols import PumpStatus
from rig.config import Tank
from rig.errors import CaptureError, InterlockError, LevelUnknownError, TankAlarmError
from rig.tank.ledger import Ledger, Unknown, known_ml, level_text

ActionKind = Literal["home", "move", "fill", "drain", "photo", "hands"]
ACTIONS: dict[ActionKind, str] = {
    "home": "home the stage",
    "move": "move the stage",
    "fill": "start a fill",
    "drain": "start a drain",
    "photo": "take a photo",
    "hands": "ask for hands in the tank",
}
EVERYTHING: tuple[ActionKind, ...] = tuple(ACTIONS)
# Sums of counted volumes are rounded; a drop is no overflow.
ROUNDING_ML = 1.0


@dataclass(frozen=True, slots=True)
class Action:
    """What somebody is about to do; ``volume_ml`` belongs to a fill or drain."""

    kind: ActionKind
    volume_ml: float = 0.0


@dataclass(frozen=True, slots=True)
class RigState:
    """What is known of the rig at this moment. ``pump`` is None where there is none, or where it was not asked."""

    ledger: Ledger
    pump: PumpStatus | None = None
    stage_moves: bool = False
    exposing: bool = False
    tank: Tank | None = None


@dataclass(frozen=True, slots=True)
class Interlock:
    """One row: these actions are forbidden while this condition holds; ``sentence`` is what the operator reads."""

    forbids: tuple[ActionKind, ...]
    condition: str
    holds: Callable[[Action, RigState], bool]
    sentence: str
    error: type[CaptureError] = InterlockError


def _alarm(_action: Action, state: RigState) -> bool:
    return state.pump is not None and bool(state.pump.alarm)


def _pump_may_run(_action: Action, state: RigState) -> bool:
    # Who has not asked the pump itself must believe the ledger.
    return state.ledger.open_flow is not None if state.pump is None else state.pump.running


def _stage_moves(_action: Action, state: RigState) -> bool:
    return state.stage_moves


def _exposing(_action: Action, state: RigState) -> bool:
    return state.exposing


def _tank_unknown(_action: Action, state: RigState) -> bool:
    return isinstance(state.ledger.tank, Unknown)


def _reservoir_unknown(_action: Action, state: RigState) -> bool:
    return isinstance(state.ledger.reservoir, Unknown)


def _tank_too_small(action: Action, state: RigState) -> bool:
    tank_ml = known_ml(state.ledger.tank)
    return state.tank is not None and tank_ml is not None and tank_ml + action.volume_ml > state.tank.free_volume_ml


def _reservoir_too_empty(action: Action, state: RigState) -> bool:
    reservoir_ml = known_ml(state.ledger.reservoir)
    return reservoir_ml is not None and action.volume_ml > reservoir_ml + ROUNDING_ML


def _reservoir_too_small(action: Action, state: RigState) -> bool:
    tank_ml, reservoir_ml = known_ml(state.ledger.tank), known_ml(state.ledger.reservoir)
    if state.tank is None or tank_ml is None or reservoir_ml is None:
        return False
    coming_ml = min(action.volume_ml, tank_ml)  # a pump that draws air moves nothing
    return reservoir_ml + coming_ml > state.tank.reservoir_can_hold_ml + ROUNDING_ML


# The first row that holds is the one that is told.
INTERLOCKS: tuple[Interlock, ...] = (
    Interlock(
        EVERYTHING,
        "pump or tank board report a leak, an over-fill, or any other alarm",
        _alarm,
        "pump: {alarm}; it is not safe to {act}, look at tank and pump first",
        TankAlarmError,
    ),
    Interlock(
        EVERYTHING,
        "the pump runs; or nobody has asked it, and a flow has no end on record",
        _pump_may_run,
        "the pump is running, or was never told to stop, so it is not safe to {act}; stop it (`rig pump stop`) and try again",
    ),
    Interlock(
        EVERYTHING,
        "the stage is under way",
        _stage_moves,
        "the stage is under way, so it is not safe to {act}; wait until it stands",
    ),
    Interlock(
        EVERYTHING,
        "a photo is being exposed",
        _exposing,
        "a photo is being exposed, so it is not safe to {act}; wait until the shutter has closed",
    ),
    Interlock(
        ("fill", "drain"),
        "nobody knows what the tank holds",
        _tank_unknown,
        "what the tank holds is {tank}; it is not safe to {act} before you measure it and say so with `rig pump level ML`",
        LevelUnknownError,
    ),
    Interlock(
        ("drain",),
        "nobody knows what the reservoir holds",
        _reservoir_unknown,
        "what the reservoir holds is {reservoir}; it is not safe to {act} before you say so with "
        "`rig pump level ML --reservoir ML`",
        LevelUnknownError,
    ),
    Interlock(
        ("fill",),
        "the fill would take the tank past its free volume",
        _tank_too_small,
        "pump: a fill of {volume} asked, the tank holds {tank} and may hold {free}; fill less, or drain the tank first",
    ),
    Interlock(
        ("fill",),
        "the reservoir does not hold that much",
        _reservoir_too_empty,
        "pump: a fill of {volume} asked, the reservoir holds {reservoir}; put liquid in and say so with "
        "`rig pump level ML --reservoir ML`",
    ),
    Interlock(
        ("drain",),
        "the reservoir cannot take what comes out of the tank",
        _reservoir_too_small,
        "pump: a drain of {volume} asked, the reservoir holds {reservoir} and can hold {capacity}; empty it and say so with "
        "`rig pump level ML --reservoir ML`, or correct reservoir_capacity_ml in section [tank]",
    ),
)


def broken_by(action: Action, state: RigState) -> Interlock | None:
    """Return the first interlock that forbids ``action`` in ``state``."""
    return next((row for row in INTERLOCKS if action.kind in row.forbids and row.holds(action, state)), None)


def told(row: Interlock, action: Action, state: RigState) -> str:
    """Return the sentence of ``row`` for this action in this state."""
    tank = state.tank
    return row.sentence.format(
        act=ACTIONS[action.kind],
        alarm=state.pump.alarm if state.pump else "",
        volume=f"{action.volume_ml:.0f} ml",
        tank=level_text(state.ledger.tank),
        reservoir=level_text(state.ledger.reservoir),
        free=f"{tank.free_volume_ml:.0f} ml" if tank else "nothing",
        capacity=f"{tank.reservoir_can_hold_ml:.0f} ml" if tank else "nothing",
    )


def forbidden(action: Action, state: RigState) -> str | None:
    """Return in one sentence why ``action`` must not be done in ``state``; None when it may."""
    row = broken_by(action, state)
    return None if row is None else told(row, action, state)
