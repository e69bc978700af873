"""The ledger of the liquid: what is known, what is not, and that it is never known too well."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.errors import LedgerError
from rig.tank.ledger import (
    Event,
    FlowBegun,
    FlowBroken,
    FlowEnded,
    Known,
    Ledger,
    LevelLearnt,
    Unknown,
    after,
    entry_of,
    event_of,
    level_text,
    new_ledger,
)
from rig.tank.ledger_book import LedgerBook, book_file

WHEN = "2026-03-14T09:26:53.589+00:00"
TOTAL_ML = 5000.0

volumes = st.floats(0.0, TOTAL_ML)
events = st.one_of(
    st.builds(FlowBegun, st.sampled_from(["fill", "drain"]), volumes, st.sampled_from(["vessel", "cylinder"])),
    st.builds(FlowEnded, volumes),
    st.builds(FlowBroken, st.text(max_size=9)),
    st.builds(LevelLearnt, st.sampled_from(["tank", "reservoir"]), volumes, st.sampled_from(["measured", "told"])),
)


def ledger_of(*happened: Event) -> Ledger:
    ledger = new_ledger(total_ml=TOTAL_ML)
    for event in happened:
        ledger = after(ledger, event, when=WHEN)
    return ledger


def told(tank_ml: float) -> LevelLearnt:
    return LevelLearnt("tank", tank_ml, "told")


def test_a_new_rig_knows_nothing() -> None:
    ledger = new_ledger(total_ml=TOTAL_ML)
    assert isinstance(ledger.tank, Unknown)
    assert isinstance(ledger.reservoir, Unknown)


def test_what_is_not_in_the_tank_is_in_the_reservoir() -> None:
    ledger = ledger_of(told(1200.0))
    assert ledger.tank == Known(1200.0, "told", WHEN)
    assert ledger.reservoir == Known(3800.0, "counted", WHEN)


def test_a_refilled_reservoir_adds_to_the_liquid_there_is() -> None:
    ledger = ledger_of(
        told(0.0), LevelLearnt("reservoir", 5500.0, "told"), FlowBegun("fill", 4000.0), FlowEnded(4000.0)
    )
    assert (ledger.tank.ml, ledger.reservoir.ml) == (4000.0, 1500.0)
    assert after(ledger, told(3900.0), when=WHEN).reservoir.ml == 1600.0


@given(st.lists(events, max_size=20), st.sampled_from(["fill", "drain"]), volumes)
def test_from_the_intent_to_pump_to_its_end_nobody_knows_what_is_where(happened, direction, volume_ml: float) -> None:
    ledger = ledger_of(*happened, FlowBegun(direction, volume_ml))
    assert isinstance(ledger.tank, Unknown)
    assert isinstance(ledger.reservoir, Unknown)
    assert f"a {direction} of {volume_ml:.0f} ml began" in ledger.tank.why


@given(st.lists(events, max_size=20), st.text())
def test_a_broken_flow_leaves_the_tank_unknown_until_it_is_measured_or_told(happened, why: str) -> None:
    ledger = ledger_of(*happened, FlowBegun("fill", 10.0), FlowBroken(why))
    assert ledger.tank == Unknown(why)
    # Further flows count from the unknown to the unknown.
    ledger = after(after(ledger, FlowBegun("drain", 10.0), when=WHEN), FlowEnded(10.0), when=WHEN)
    assert isinstance(ledger.tank, Unknown)
    assert after(ledger, told(7.0), when=WHEN).tank == Known(7.0, "told", WHEN)


@given(volumes, st.lists(st.tuples(st.sampled_from(["fill", "drain"]), volumes), max_size=10))
def test_counted_flows_add_up_and_the_tank_is_never_thought_emptier_than_it_is(tank_ml: float, flows) -> None:
    """The hand calculation: a fill adds what was counted, a drain takes it away down to nothing."""
    ledger, expected_ml = ledger_of(told(tank_ml)), tank_ml
    for direction, moved_ml in flows:
        ledger = after(after(ledger, FlowBegun(direction, moved_ml), when=WHEN), FlowEnded(moved_ml), when=WHEN)
        expected_ml = expected_ml + moved_ml if direction == "fill" else max(0.0, expected_ml - moved_ml)
    assert ledger.tank.ml == pytest.approx(expected_ml)


def test_what_goes_into_a_cylinder_leaves_the_one_vessel_and_reaches_no_other() -> None:
    ledger = ledger_of(told(1000.0), FlowBegun("drain", 200.0, "cylinder"), FlowEnded(200.0))
    assert (ledger.tank.ml, ledger.reservoir.ml, ledger.total_ml) == (800.0, 4000.0, 4800.0)


def test_a_level_is_told_with_how_and_when_it_was_learnt() -> None:
    assert level_text(Known(1234.4, "counted", "2026-03-14T09:26:53+00:00"), limit_ml=6000.0).startswith(
        "1234 ml of 6000 ml (counted at "
    )
    assert level_text(Unknown("nobody has said yet")) == "unknown: nobody has said yet"


@given(events)
def test_every_event_comes_back_from_its_line(event: Event) -> None:
    name, fields = entry_of(event)
    assert event_of(json.loads(json.dumps({"event": name, "time": WHEN, **fields}))) == event


# Kept in a file


def test_a_book_that_is_opened_again_knows_the_same(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "book.jsonl"
    book = LedgerBook(path, total_ml=TOTAL_ML)
    for event in (told(100.0), FlowBegun("fill", 50.0), FlowEnded(49.5)):
        book.note(event)
    again = LedgerBook(path, total_ml=TOTAL_ML).ledger
    assert again.tank.ml == book.ledger.tank.ml == 149.5
    assert again.reservoir.ml == 4850.5


def test_the_intent_is_on_disk_before_the_pump_may_turn_and_a_torn_line_is_no_end(tmp_path: Path) -> None:
    path = tmp_path / "book.jsonl"
    book = LedgerBook(path, total_ml=TOTAL_ML)
    book.note(told(100.0))
    book.note(FlowBegun("fill", 50.0))
    assert isinstance(LedgerBook(path, total_ml=TOTAL_ML).ledger.tank, Unknown)
    with path.open("ab") as file:  # the power fails while the end is written
        file.write(b'{"event": "flow_ended", "moved_ml": 5')
    assert isinstance(LedgerBook(path, total_ml=TOTAL_ML).ledger.tank, Unknown)


@pytest.mark.parametrize(
    "line",
    [
        "nonsense",
        '{"event": "flow_guessed", "time": "2026-03-14T09:26:53+00:00"}',
        '{"event": "flow_ended", "moved_ml": "much", "time": "2026-03-14T09:26:53+00:00"}',
        '{"event": "flow_ended", "moved_ml": 5}',
        '{"event": "level_learnt", "vessel": "bucket", "ml": 5, "how": "told", "time": "2026-03-14T09:26:53+00:00"}',
    ],
)
def test_a_damaged_book_is_refused_with_what_to_do(tmp_path: Path, line: str) -> None:
    path = tmp_path / "book.jsonl"
    path.write_text(line + "\n", encoding="utf-8")
    with pytest.raises(LedgerError, match=r"book\.jsonl: what is known .* cannot be read .* `rig pump level`"):
        LedgerBook(path, total_ml=TOTAL_ML)


def test_each_pump_has_its_own_book_and_a_rig_without_one_has_none(tmp_path: Path) -> None:
    assert book_file(tmp_path, "new_era:/dev/ttyUSB1") == tmp_path / "liquid" / "new-era-dev-ttyUSB1.jsonl"
    assert book_file(tmp_path, "") is None
