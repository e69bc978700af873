"""The plan: whole, safe and the same again, for every configuration and from every state in between."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.config import RigConfig, Tank
from rig.planning.plan import LEVEL_TOLERANCE, all_photos, plan_capture, set_name, set_order, summarise
from rig.planning.plan_table import codes_text
from rig.planning.steps import (
    AskOperator,
    DrainTank,
    FillTank,
    HomeStage,
    MoveStage,
    PhotoKey,
    StartSweep,
    Step,
    TakePhoto,
    WaitUntilStill,
)
from rig.rehearsing.scene_config import SceneOptions, config_of_scene
from sim_backend.scene import load_scene

SCENES = {name: load_scene(name).resized(display_columns=32) for name in ("semi_ellipsoid", "thin_cone")}


@st.composite
def configs(draw: st.DrawFn, *, scenes: tuple[str, ...] = tuple(SCENES)) -> RigConfig:
    options = SceneOptions(
        profile=draw(st.sampled_from(["hard", "raised_cosine"])),
        width_px=draw(st.floats(0.5, 12.0)),
        step_px=draw(st.floats(1.0, 15.0)),
        order=draw(st.sampled_from(["one_fill", "paper"])),
    )
    config = config_of_scene(SCENES[draw(st.sampled_from(scenes))], options)
    if config.tank is None:
        return config
    fill_ml = draw(st.floats(10.0, 6000.0))
    tank = Tank(
        free_volume_ml=6000.0,
        fill_ml=fill_ml,
        reservoir_ml=draw(st.floats(fill_ml, 6000.0)),
        has_pump=draw(st.booleans()),
        pump_rate_ml_per_min=draw(st.floats(10.0, 5000.0)),
        drain_at_end=draw(st.booleans()),
    )
    return config.model_copy(update={"tank": tank})


@st.composite
def situations(draw: st.DrawFn) -> tuple[RigConfig, frozenset[PhotoKey], float]:
    """A configuration, the photos that are done, and what the tank holds."""
    config = draw(configs())
    keys = [photo.key for photo in all_photos(config)]
    whole_sets = draw(st.sets(st.sampled_from([set_name(place) for place in set_order(config)])))
    single = draw(st.sets(st.sampled_from(keys)))
    done = frozenset(key for key in keys if key in single or key[0] in whole_sets)
    fill_ml = config.tank.fill_ml if config.tank else 0.0
    return config, done, draw(st.sampled_from([0.0, 0.3 * fill_ml, fill_ml]))


def photos_of(plan: tuple[Step, ...]) -> list[TakePhoto]:
    return [step for step in plan if isinstance(step, TakePhoto)]


@given(situations())
def test_every_set_becomes_complete_and_no_photo_is_taken_twice(situation) -> None:
    config, done, tank_ml = situation
    planned = [photo.key for photo in photos_of(plan_capture(config, done=done, tank_ml=tank_ml))]
    assert set(planned) | done == {photo.key for photo in all_photos(config)}
    assert not set(planned) & done
    assert len(planned) == len(set(planned))


@given(configs())
def test_every_set_has_a_sweep_along_each_axis_and_a_white_and_a_black_photo(config: RigConfig) -> None:
    counts = Counter((photo.set_name, photo.sweep) for photo in photos_of(plan_capture(config)))
    for place in set_order(config):
        for axis in ("x", "y"):
            assert counts[set_name(place), axis] == config.pattern(axis).count >= 3
        assert counts[set_name(place), "white"] == counts[set_name(place), "black"] == 1


@given(situations())
def test_each_photo_is_taken_at_its_place_with_the_tank_and_the_object_as_its_set_says(situation) -> None:
    config, done, tank_ml = situation
    position, homed, object_present = None, False, None
    for step in plan_capture(config, done=done, tank_ml=tank_ml):
        match step:
            case HomeStage():
                homed = True
            case MoveStage():
                assert homed
                position = step.position
                assert step.position_mm == config.stage.position_mm(step.position)
            case FillTank():
                assert config.tank is not None
                tank_ml += step.volume_ml
                assert tank_ml == pytest.approx(step.to_ml)
                assert tank_ml <= config.tank.free_volume_ml * (1 + 1e-9)
                assert step.volume_ml > 0
            case DrainTank():
                tank_ml -= step.volume_ml
                assert tank_ml == pytest.approx(step.to_ml)
                assert step.volume_ml > 0
            case AskOperator(request="fill_tank"):
                assert config.tank is not None
                tank_ml = config.tank.fill_ml
            case AskOperator(request="drain_tank"):
                tank_ml = 0.0
            case AskOperator():
                object_present = step.request == "insert_object"
            case TakePhoto():
                condition = step.set_name.removeprefix(f"pos{position}_")
                if config.tank is not None:
                    target_ml = config.tank.fill_ml if condition == "liquid" else 0.0
                    assert condition in ("air", "liquid")
                    assert abs(tank_ml - target_ml) <= LEVEL_TOLERANCE * config.tank.fill_ml
                else:
                    assert condition == ("with" if object_present else "without")
            case _:
                assert isinstance(step, WaitUntilStill | StartSweep)


@given(configs(scenes=("semi_ellipsoid",)))
def test_by_default_the_tank_is_filled_once_and_drained_only_after_the_last_photo(config: RigConfig) -> None:
    if config.capture.order == "paper" or config.tank is None or not config.tank.has_pump:
        return
    plan = plan_capture(config)
    assert sum(isinstance(step, FillTank) for step in plan) == 1
    last_photo = max(number for number, step in enumerate(plan) if isinstance(step, TakePhoto))
    drains = [number for number, step in enumerate(plan) if isinstance(step, DrainTank)]
    assert all(number > last_photo for number in drains)
    assert len(drains) == config.tank.drain_at_end


def test_the_papers_order_comes_on_request(config: RigConfig) -> None:
    assert [set_name(place) for place in set_order(config)] == ["pos0_air", "pos1_air", "pos1_liquid", "pos0_liquid"]
    capture = config.capture.model_copy(update={"order": "paper"})
    plan = plan_capture(config.model_copy(update={"capture": capture}))
    sets = list(dict.fromkeys(photo.set_name for photo in photos_of(plan)))
    assert sets == ["pos0_air", "pos0_liquid", "pos1_air", "pos1_liquid"]
    assert sum(isinstance(step, FillTank) for step in plan) == 2


@given(situations())
def test_a_frame_keeps_its_number_when_the_capture_is_resumed(situation) -> None:
    config, done, tank_ml = situation
    numbers = {photo.key: photo.frame_id for photo in all_photos(config)}
    assert len(set(numbers.values())) == len(numbers)
    for photo in photos_of(plan_capture(config, done=done, tank_ml=tank_ml)):
        assert photo.frame_id == numbers[photo.key]


@given(configs())
def test_nothing_is_planned_when_all_is_done(config: RigConfig) -> None:
    assert plan_capture(config, done={photo.key for photo in all_photos(config)}) == ()


@given(situations())
def test_a_sweep_announces_the_photos_that_follow_it(situation) -> None:
    config, done, tank_ml = situation
    plan = plan_capture(config, done=done, tank_ml=tank_ml)
    for number, step in enumerate(plan):
        if isinstance(step, StartSweep):
            following = plan[number + 1 : number + 1 + step.count]
            assert [(p.set_name, p.sweep) for p in photos_of(following)] == [(step.set_name, step.axis)] * step.count


@given(situations())
def test_after_every_move_and_every_flow_the_rig_comes_to_rest(situation) -> None:
    config, done, tank_ml = situation
    plan = plan_capture(config, done=done, tank_ml=tank_ml)
    moved_at = None
    for number, step in enumerate(plan):
        if isinstance(step, MoveStage | FillTank | DrainTank):
            moved_at = number
        elif isinstance(step, TakePhoto) and moved_at is not None:
            assert isinstance(plan[moved_at + 1], WaitUntilStill)


def test_the_summary_adds_up_by_hand(config: RigConfig) -> None:
    # 32 columns and 32 rows in steps of 4: places 0, 4, … 28 are 8; two sweeps, white and black; four sets.
    summary = summarise(plan_capture(config), config)
    assert summary.photos == 4 * (8 + 8 + 2)
    assert (summary.sets, summary.moves, summary.fills, summary.drains, summary.questions) == (4, 3, 1, 1, 0)
    assert config.tank is not None
    assert summary.litres == pytest.approx(2 * config.tank.fill_ml / 1000)
    # 72 photos of 2.1 s, 2 × 4000 ml at 12,000 ml/min, four ways over 30 mm at 5 mm/s, 3 × 2 s and 60 s of rest
    assert summary.minutes * 60 == pytest.approx(72 * 2.1 + 2 * 20 + 4 * 6 + 3 * 2 + 60)


def test_a_display_of_2048_by_1536_takes_264_photos_with_a_gray_code_and_the_plan_says_so() -> None:
    scene = load_scene("hemisphere").resized(display_columns=2048)
    config = config_of_scene(scene, SceneOptions(code="gray_line"))
    assert summarise(plan_capture(config), config).photos == 264
    assert (
        codes_text(config) == "the same area by code: stripe every 1 px 14,344 photos, gray_line 264, phase_shift 200"
    )
