"""The table of interlocks: each row by itself, the page that prints it, and the rooms that obey it."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.protocols import PumpStatus
from rig.config import Tank
from rig.errors import CaptureError
from rig.tank.guard import Guard
from rig.tank.interlocks import ACTIONS, EVERYTHING, INTERLOCKS, Action, RigState, forbidden
from rig.tank.ledger import FlowBegun, FlowEnded, Ledger, LevelLearnt, after, new_ledger
from rig.tank.ledger_book import LedgerBook

WHEN = "2026-03-14T09:26:53+00:00"
PAGE = Path(__file__).parents[2] / "docs/explanation/safety.md"
STANDS = PumpStatus(running=False, direction=None, moved_ml=0.0)
RUNS = PumpStatus(running=True, direction="fill", moved_ml=3.0)
LEAKS = PumpStatus(running=False, direction=None, moved_ml=0.0, alarm="the leak contact is open")
TANK = Tank(
    free_volume_ml=6000.0,
    fill_ml=4500.0,
    reservoir_ml=5000.0,
    reservoir_capacity_ml=5500.0,
    has_pump=True,
    pump_rate_ml_per_min=600.0,
    drain_at_end=True,
)


def ledger(tank_ml: float, *, reservoir_ml: float | None = None) -> Ledger:
    known = after(new_ledger(total_ml=5000.0), LevelLearnt("tank", tank_ml, "told"), when=WHEN)
    if reservoir_ml is None:
        return known
    return after(known, LevelLearnt("reservoir", reservoir_ml, "told"), when=WHEN)


EMPTY, HALF = ledger(0.0), ledger(2500.0)
BEGUN = after(HALF, FlowBegun("fill", 300.0), when=WHEN)
UNTOLD = new_ledger(total_ml=5000.0)


@pytest.mark.parametrize("kind", EVERYTHING)
def test_a_rig_at_rest_forbids_nothing(kind) -> None:
    assert forbidden(Action(kind, 100.0), RigState(HALF, pump=STANDS, tank=TANK)) is None


@pytest.mark.parametrize("kind", EVERYTHING)
@pytest.mark.parametrize(
    ("state", "why"),
    [
        (RigState(HALF, pump=LEAKS, tank=TANK), "the leak contact is open"),
        (RigState(HALF, pump=RUNS, tank=TANK), "the pump is running"),
        (RigState(BEGUN, pump=None, tank=TANK), "was never told to stop"),
        (RigState(HALF, pump=STANDS, stage_moves=True, tank=TANK), "the stage is under way"),
        (RigState(HALF, pump=STANDS, exposing=True, tank=TANK), "a photo is being exposed"),
    ],
    ids=["alarm", "pump runs", "flow without an end", "stage moves", "exposure"],
)
def test_what_is_under_way_forbids_everything(kind, state: RigState, why: str) -> None:
    sentence = forbidden(Action(kind, 100.0), state)
    assert sentence is not None
    assert why in sentence
    assert f"not safe to {ACTIONS[kind]}" in sentence


@pytest.mark.parametrize(
    ("action", "found", "why"),
    [
        (Action("fill", 1.0), UNTOLD, "what the tank holds is unknown: nobody has said yet"),
        (Action("drain", 1.0), UNTOLD, "what the tank holds is unknown: nobody has said yet"),
        (Action("fill", 3501.0), HALF, "a fill of 3501 ml asked, the tank holds 2500 ml"),
        (Action("fill", 2502.0), HALF, "the reservoir holds 2500 ml"),
        (Action("drain", 2500.0), ledger(2500.0, reservoir_ml=3002.0), "can hold 5500 ml"),
    ],
)
def test_a_flow_that_does_not_fit_or_of_which_too_little_is_known_is_forbidden(action, found, why: str) -> None:
    sentence = forbidden(action, RigState(found, pump=STANDS, tank=TANK))
    assert sentence is not None
    assert why in sentence


@pytest.mark.parametrize(
    ("action", "found"),
    [
        (Action("fill", 3500.0), ledger(2500.0, reservoir_ml=4000.0)),  # exactly to the rim
        (Action("fill", 2500.0), HALF),  # the last drop of the reservoir
        (Action("drain", 2500.0), ledger(2500.0, reservoir_ml=3000.0)),  # exactly to the reservoir's rim
        (Action("drain", 99999.0), HALF),  # what is not in the tank cannot come out of it
        (Action("photo"), UNTOLD),
        (Action("move"), UNTOLD),
    ],
)
def test_what_fits_is_allowed(action: Action, found: Ledger) -> None:
    assert forbidden(action, RigState(found, pump=STANDS, tank=TANK)) is None


@given(st.floats(0.0, 6000.0), st.floats(0.0, 5500.0), st.floats(0.0, 20000.0))
def test_no_fill_that_is_allowed_can_reach_the_rim_and_no_drain_the_reservoirs(
    tank_ml, reservoir_ml, volume_ml
) -> None:
    state = RigState(ledger(tank_ml, reservoir_ml=reservoir_ml), pump=STANDS, tank=TANK)
    if forbidden(Action("fill", volume_ml), state) is None:
        assert tank_ml + volume_ml <= 6000.0
    if forbidden(Action("drain", volume_ml), state) is None:
        assert reservoir_ml + min(volume_ml, tank_ml) <= 5501.0  # a millilitre of rounding


def test_the_page_on_safety_prints_the_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for row in INTERLOCKS:
        actions = "everything" if row.forbids == EVERYTHING else ", ".join(ACTIONS[kind] for kind in row.forbids)
        line = f"| {row.condition} | {actions} | {row.sentence} |"
        assert line in text, f"docs/explanation/safety.md lacks the row\n{line}"
    assert text.count("\n| ") >= len(INTERLOCKS)


# The guard


class CountingPump:
    def __init__(self, status: PumpStatus) -> None:
        self.answer = status

    def status(self) -> PumpStatus:
        return self.answer


def test_the_guard_raises_the_sentence_and_nothing_else() -> None:
    book = LedgerBook(None, total_ml=5000.0)
    guard = Guard(pump=CountingPump(STANDS), book=book, tank=TANK)
    guard.check("photo")
    with pytest.raises(CaptureError, match=r"^what the tank holds is unknown: nobody has said yet"):
        guard.check("fill", volume_ml=10.0)
    book.note(LevelLearnt("tank", 0.0, "told"))
    guard.check("fill", volume_ml=10.0)


def test_the_guard_knows_what_is_under_way_and_when_it_is_over() -> None:
    book = LedgerBook(None, total_ml=5000.0)
    guard = Guard(pump=None, book=book, tank=None)
    with guard.moving(), pytest.raises(CaptureError, match="stage is under way"):
        guard.check("photo")
    with guard.exposing(), pytest.raises(CaptureError, match="being exposed"):
        guard.check("move")
    with pytest.raises(RuntimeError), guard.moving():
        raise RuntimeError
    guard.check("photo")


def test_without_the_pump_the_guard_believes_the_ledger() -> None:
    book = LedgerBook(None, total_ml=5000.0)
    guard = Guard(pump=None, book=book, tank=TANK)
    book.note(FlowBegun("fill", 10.0))
    with pytest.raises(CaptureError, match="never told to stop"):
        guard.check("move")
    book.note(FlowEnded(10.0))
    guard.check("move")
