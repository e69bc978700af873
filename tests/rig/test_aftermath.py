"""What a journal says of how its last program ended."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.capturing.aftermath import FINISHES, Aftermath, aftermath, aftermath_text

STARTED = {"event": "capture_started", "photos": 72, "done": 0, "tank_ml": 0.0}
HOMED = [{"event": "homing_started"}, {"event": "homing_finished", "stage_mm": 0.0}]
MOVE = {"event": "move_started", "position": 1, "to_mm": 40.0}
MOVED = {"event": "move_finished", "position": 1, "stage_mm": 40.0}
FILL = {"event": "fill_started", "volume_ml": 4000.0, "to_ml": 4000.0, "max_run_s": 240.0}
FILLED = {"event": "fill_stopped", "moved_ml": 4000.0, "tank_ml": 4001.0}
DRAIN = {"event": "drain_started", "volume_ml": 4000.0, "to_ml": 0.0, "max_run_s": 240.0}
PHOTO = {"event": "photo", "set": "pos1_air", "sweep": "x", "index": 0}
POUR = {"event": "operator_asked", "request": "fill_tank", "text": "Fill the tank slowly"}
INSERT = {"event": "operator_asked", "request": "insert_object", "text": "Put the object in"}
TANK_UNKNOWN = "not known from the journal: what the tank holds"
STAGE_UNKNOWN = "not known from the journal: where the stage stands"
KILLED = "the last program ended without a word: it was killed, or the power went"


def test_a_capture_that_finished_leaves_nothing_to_say() -> None:
    after = aftermath([STARTED, *HOMED, MOVE, MOVED, FILL, FILLED, PHOTO, {"event": "capture_finished"}])
    assert after == Aftermath("finished", (), tank_ml=4001.0, stage_mm=40.0)
    assert aftermath_text(after) == ()


@pytest.mark.parametrize(
    ("last", "tank_ml", "stage_mm", "told"),
    [
        ([PHOTO], 0.0, 40.0, ()),
        (
            [FILL],
            None,
            40.0,
            ("under way when it ended: a fill of 4000 ml", TANK_UNKNOWN),
        ),
        (
            [FILL, FILLED, DRAIN],
            None,
            40.0,
            ("under way when it ended: a drain of 4000 ml", TANK_UNKNOWN),
        ),
        (
            [{"event": "homing_started"}],
            0.0,
            None,
            ("under way when it ended: the homing of the stage", STAGE_UNKNOWN),
        ),
        (
            [MOVE],
            0.0,
            None,
            (
                "under way when it ended: a move of the display to position 1 (40 mm)",
                STAGE_UNKNOWN,
            ),
        ),
        (
            [POUR],
            None,
            40.0,
            (
                "under way when it ended: a request to the operator (Fill the tank slowly)",
                TANK_UNKNOWN,
            ),
        ),
        (
            [INSERT],
            0.0,
            40.0,
            (
                "under way when it ended: a request to the operator (Put the object in)",
                "not known from the journal: whether the object is in its place",
            ),
        ),
    ],
    ids=["photo", "fill", "drain", "homing", "move", "pour", "insert"],
)
def test_what_was_under_way_when_the_power_went_is_named_and_its_outcome_is_unknown(
    last: list[dict[str, Any]], tank_ml: float | None, stage_mm: float | None, told: tuple[str, ...]
) -> None:
    after = aftermath([STARTED, *HOMED, MOVE, MOVED, *last])
    assert (after.tank_ml, after.stage_mm) == (tank_ml, stage_mm)
    assert (after.tank_is_unknown, after.stage_is_unknown) == (tank_ml is None, stage_mm is None)
    assert after.ending == "without a word"
    assert aftermath_text(after) == (KILLED, *told)


def test_the_next_program_knows_the_level_again_and_homes_the_stage() -> None:
    resumed = {"event": "capture_resumed", "tank_ml": 1234.0}
    after = aftermath([STARTED, *HOMED, MOVE, MOVED, FILL, resumed])
    assert after.under_way == ()
    assert after.tank_ml == 1234.0
    assert after.stage_is_unknown
    assert aftermath([STARTED, FILL, resumed, *HOMED, MOVE, MOVED]).stage_mm == 40.0


def test_a_latch_outlives_the_program_until_somebody_has_looked() -> None:
    latched = [STARTED, FILL, {"event": "latched", "cause": "pump lost", "text": "pump: silent"}]
    assert aftermath(latched).latch == "pump: silent"
    assert aftermath([*latched, {"event": "capture_failed"}]).latch == "pump: silent"
    assert aftermath([*latched, {"event": "unlatched"}]).latch == ""


intents = st.sampled_from([FILL, DRAIN, MOVE, POUR, INSERT, {"event": "homing_started"}])
ends = st.sampled_from([{"event": event, "tank_ml": 1.0, "stage_mm": 2.0} for event in FINISHES])


@given(st.lists(intents | ends | st.just(PHOTO) | st.just(STARTED)))
def test_whatever_a_journal_holds_a_flow_without_its_end_leaves_the_tank_unknown(entries: list[dict[str, Any]]) -> None:
    after = aftermath(entries)
    last_flow = max((n for n, entry in enumerate(entries) if entry in (FILL, DRAIN, POUR)), default=-1)
    ended = any(entry.get("tank_ml") is not None and entry["event"] != "photo" for entry in entries[last_flow + 1 :])
    if not ended:
        assert after.tank_is_unknown


def test_the_journal_of_a_whole_capture_is_read_as_it_was(captured: Path, config) -> None:
    lines = (captured / "journal.jsonl").read_text().splitlines()
    after = aftermath(json.loads(line) for line in lines)
    assert after.ending == "finished"
    assert after.tank_ml == pytest.approx(0.0)
    assert after.stage_mm == pytest.approx(config.stage.position_mm(0))
    # Cut anywhere, the same journal tells of at most one thing under way.
    assert all(len(aftermath(json.loads(line) for line in lines[:end]).under_way) <= 1 for end in range(len(lines)))
