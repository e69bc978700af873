"""Some hundred of the random rigs of ``tests/bench/random_captures.py``, and proof that their judge sees what it must."""

import logging
from collections.abc import Iterator

import pytest

from rig.tank import interlocks
from rig.tank.ledger import FlowBegun
from rig.tank.ledger_book import LedgerBook
from sim_backend import tank_board_emulator
from sim_backend.new_era_motor import Motor
from sim_backend.world import TankSize, WorldState
from tests.bench._random_rig import Life, WatchedWorld
from tests.bench.random_captures import Bench, Tally, bench, one_run

# About two seconds on a quiet machine; the bench runs ten thousand.
RUNS = 40


@pytest.fixture(scope="module")
def shared() -> Bench:
    return bench()


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Drivers warn of what is done to them here; that is not the point."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def runs(shared: Bench, seeds: range, *, until_caught: bool = False) -> Tally:
    tally = Tally()
    for seed in seeds:
        tally.add(one_run(shared, seed))
        if until_caught and tally.violations:
            break
    return tally


def test_no_random_rig_floods_or_moves_when_it_must_not(shared: Bench) -> None:
    tally = runs(shared, range(100_000, 100_000 + RUNS))
    assert tally.violations == {}
    assert tally.runs == RUNS
    # They did not just refuse everything, and not everything went well.
    for what in ("photos", "flows", "killed", "accidents", "whole captures", "ended with a sentence"):
        assert tally.counts[what] > RUNS / 20, what
    assert tally.counts["runs with software alone against the rim"] > RUNS / 4


# A judge that sees nothing is no judge: each layer is taken away, and the same runs must be found out.


def test_the_judge_sees_a_rig_without_the_interlock_of_the_rim(shared: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = tuple(row for row in interlocks.INTERLOCKS if "free volume" not in row.condition)
    assert len(kept) == len(interlocks.INTERLOCKS) - 1
    monkeypatch.setattr(interlocks, "INTERLOCKS", kept)
    caught = runs(shared, range(200_000, 200_200), until_caught=True).violations
    assert any("ran over the tank's rim" in told for violations in caught.values() for told in violations)


def test_the_judge_sees_a_rig_that_forgets_its_intent_to_pump(shared: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    note = LedgerBook.note

    def forgets(book: LedgerBook, event: object) -> None:
        if not isinstance(event, FlowBegun):
            note(book, event)

    monkeypatch.setattr(LedgerBook, "note", forgets)
    caught = runs(shared, range(200_000, 200_200), until_caught=True).violations
    assert any("ran over the tank's rim" in told for violations in caught.values() for told in violations)


def test_the_judge_sees_pumps_without_a_dead_man_timer(shared: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tank_board_emulator, "HEARTBEAT_MS", 10**9)
    monkeypatch.setattr(Motor, "_silent_at_s", lambda _motor: float("inf"))
    caught = runs(shared, range(200_000, 200_200), until_caught=True).violations
    assert any("the pump runs with nobody alive" in told for violations in caught.values() for told in violations)


def watched() -> WatchedWorld:
    state = WorldState(tank_ml=100.0, reservoir_ml=100.0)
    return WatchedWorld(Life(), tank=TankSize(1000.0, 500.0), state=state, reservoir_limit_ml=150.0)


def test_the_judge_sees_what_moves_during_an_exposure() -> None:
    world = watched()
    with world.exposure():
        world.start_motion(5.0, velocity_mm_per_s=1.0)
        world.show_nothing()
    assert world.violations == [
        "the stage is started while a photo is exposed",
        "another frame is shown while a photo is exposed",
        "the shutter closes while the stage moves",
    ]


def test_the_judge_sees_a_stage_and_a_pump_at_the_same_time() -> None:
    world = watched()
    world.start_flow("drain", rate_ml_per_s=1.0, volume_ml=90.0, max_run_s=90.0)
    world.start_motion(5.0, velocity_mm_per_s=0.01)
    world.clock.sleep_s(60.0)
    world.check_liquid()
    assert world.violations == ["the stage is started while the pump runs", "160 ml in the reservoir"]
