"""What happened is named by which parts of the picture moved, and nothing is named that noise can do."""

import numpy as np
import pytest

from recon.scene.scene_change import SceneLimits, SceneParts, findings, part_masks
from recon.scene.scene_shift import PartShift

LIMITS = SceneLimits(shift_px=0.05, sigmas=6.0, light_share=0.02)
STILL = (0.0, 0.0)
GONE = (0.3, 0.1)


def part(
    shift: tuple[float, float] = STILL, *, sd: float = 0.002, spread: float = 0.0, light: float = 0.0
) -> PartShift:
    length = float(np.hypot(*shift))
    return PartShift(shift, (sd, sd), length / sd, spread, spread / sd, light, 0.0005, blocks=50)


def causes(*, wet: bool = False, **parts: PartShift) -> list[str]:
    return [found.cause for found in findings(parts, LIMITS, wet=wet)]


@pytest.mark.parametrize("wet", [False, True])
def test_nothing_is_named_when_nothing_moved(wet: bool) -> None:
    assert causes(wet=wet, marks=part(), display=part(), object=part()) == []


@pytest.mark.parametrize("wet", [False, True])
def test_everything_that_moves_alike_is_the_camera(wet: bool) -> None:
    # The display is farther away than the marks, so that its picture moves less.
    assert causes(wet=wet, marks=part(GONE), display=part((0.26, 0.08)), object=part(GONE)) == ["camera"]


@pytest.mark.parametrize("wet", [False, True])
def test_marks_that_move_before_a_still_display_are_the_objects_holder(wet: bool) -> None:
    assert causes(wet=wet, marks=part(GONE), display=part(), object=part(GONE, spread=0.3)) == ["object"]


@pytest.mark.parametrize("wet", [False, True])
def test_an_object_that_slips_in_its_holder_changes_alone(wet: bool) -> None:
    assert causes(wet=wet, marks=part(), display=part(), object=part(STILL, spread=0.2)) == ["object"]
    assert causes(wet=wet, display=part(), object=part(GONE)) == ["object"]


@pytest.mark.parametrize("wet", [False, True])
def test_a_display_that_slips_moves_behind_still_marks_beside_the_object_and_through_it(wet: bool) -> None:
    assert causes(wet=wet, marks=part(), display=part(GONE), object=part((-0.2, 0.0), spread=0.2)) == ["display"]


def test_without_marks_a_display_that_moved_may_be_a_camera_that_moved() -> None:
    assert causes(display=part(GONE), object=part(GONE)) == ["camera or display"]
    assert causes(marks=part(GONE)) == ["camera or object"]


def test_a_liquid_that_is_not_still_moves_only_what_is_seen_through_its_surface() -> None:
    assert causes(wet=True, marks=part(), display=part(STILL, spread=0.2), object=part()) == ["liquid"]
    assert causes(wet=True, display=part(GONE), object=part()) == ["liquid"]
    assert causes(wet=False, marks=part(), display=part(STILL, spread=0.2), object=part()) == ["display"]


def test_a_display_that_slips_is_no_ripple_though_the_object_shows_little_of_it_and_perspective_bends_it() -> None:
    small = part((0.032, 0.0), spread=0.024)
    assert causes(wet=True, marks=part(), display=part((0.128, 0.0)), object=small) == ["display"]
    assert causes(wet=True, marks=part(), display=part((0.6, 0.0), spread=0.1), object=part(GONE)) == ["display"]


def test_light_is_named_beside_whatever_else_happened() -> None:
    assert causes(marks=part(), display=part(light=-0.05), object=part(light=-0.05)) == ["light"]
    assert causes(marks=part(), display=part(GONE, light=-0.05), object=part(GONE)) == ["display", "light"]


def test_what_is_small_or_unsure_is_not_named() -> None:
    assert causes(display=part((0.04, 0.0)), object=part(STILL, spread=0.04)) == []
    assert causes(display=part((0.2, 0.0), sd=0.05), object=part()) == []


def test_between_sets_only_the_marks_are_compared() -> None:
    change = {"marks": part(), "display": part((30.0, 4.0)), "object": part((30.0, 4.0), light=0.4)}
    assert findings(change, LIMITS, wet=True, wanted=("marks",)) == ()


def test_a_finding_is_a_sentence_with_its_size() -> None:
    (found,) = findings({"marks": part(), "display": part((0.2, 0.0)), "object": part((0.1, 0.0))}, LIMITS, wet=False)
    assert found.text == "the display slipped: its picture moved by 0.20 px (sd 0.002)"


def test_parts_keep_clear_of_each_other() -> None:
    outline = ((20.0, 20.0), (60.0, 20.0), (60.0, 60.0), (20.0, 60.0))
    masks = part_masks(SceneParts(outline, ((0.0, 0.0, 10.0, 10.0),)), rows=80, columns=100)
    assert set(masks) == {"marks", "display", "object"}
    assert not (masks["marks"] & masks["display"]).any()
    assert not (masks["object"] & masks["display"]).any()
    assert masks["object"][40, 40]
    assert masks["marks"][5, 5]
    assert masks["display"][40, 90]
    for row, column in ((40, 20), (40, 60), (10, 5)):  # on the edges
        assert not any(mask[row, column] for mask in masks.values())
    assert set(part_masks(SceneParts(), rows=8, columns=8)) == {"display"}
