"""Reference photos in the plan: before and after every sweep, numbered on, and all else as it was."""

from dataclasses import replace
from importlib import resources
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from recon.scene.scene_check import REFERENCE
from rig.capture_sections import Watch
from rig.config import load_config
from rig.planning.plan import all_photos, plan_capture, set_name, set_order
from rig.planning.steps import StartSweep, TakePhoto
from rig.rehearsing.scene_config import SceneOptions, config_of_scene
from sim_backend.scene import load_scene

SCENE = load_scene("semi_ellipsoid").resized(display_columns=32)
BARE = config_of_scene(SCENE, SceneOptions(step_px=8.0))
WATCHED = BARE.model_copy(update={"watch": Watch()})


def is_reference(step: object) -> bool:
    return isinstance(step, TakePhoto) and step.sweep == REFERENCE


@st.composite
def done_photos(draw: st.DrawFn) -> frozenset[tuple[str, str, int]]:
    keys = [photo.key for photo in all_photos(BARE)]
    names = [set_name(place) for place in set_order(BARE)]
    done = draw(st.sets(st.sampled_from(keys)))
    counts = draw(st.dictionaries(st.sampled_from(names), st.integers(1, 4)))
    return frozenset(done) | {(name, REFERENCE, index) for name, count in counts.items() for index in range(count)}


@given(done_photos())
def test_every_sweep_lies_between_two_reference_photos_of_its_set(done: frozenset[tuple[str, str, int]]) -> None:
    plan = plan_capture(WATCHED, done=done)
    for number, step in enumerate(plan):
        if isinstance(step, StartSweep):
            before, after = plan[number - 1], plan[number + 1 + step.count]
            assert is_reference(before)
            assert is_reference(after)
            assert before.set_name == after.set_name == step.set_name


@given(done_photos())
def test_reference_photos_are_numbered_on_and_none_replaces_another(done: frozenset[tuple[str, str, int]]) -> None:
    taken = [step for step in plan_capture(WATCHED, done=done) if is_reference(step)]
    for name in {step.set_name for step in taken}:
        before = sum(key[:2] == (name, REFERENCE) for key in done)
        numbers = [step.index for step in taken if step.set_name == name]
        assert numbers == list(range(before, before + len(numbers)))
    assert len({step.frame_id for step in taken}) <= 1
    assert not {step.frame_id for step in taken} & {photo.frame_id for photo in all_photos(WATCHED)}


@given(done_photos())
def test_without_its_reference_photos_the_plan_is_that_of_a_rig_that_does_not_watch(
    done: frozenset[tuple[str, str, int]],
) -> None:
    plan = plan_capture(WATCHED, done=done)
    assert tuple(step for step in plan if not is_reference(step)) == plan_capture(BARE, done=done)


def test_a_fresh_capture_begins_with_two_in_a_row_and_takes_three_in_every_set() -> None:
    plan = plan_capture(WATCHED)
    taken = [step for step in plan if is_reference(step)]
    assert [sum(step.set_name == set_name(place) for step in taken) for place in set_order(WATCHED)] == [4, 3, 3, 3]
    first = plan.index(taken[0])
    assert plan[first + 1] == replace(taken[0], index=1)


def test_the_template_watches(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text((resources.files("rig") / "template.toml").read_text("utf-8"), encoding="utf-8")
    config = load_config(file)
    # The values written there are the defaults, so that a shorter file means the same.
    assert config.watch == Watch()
