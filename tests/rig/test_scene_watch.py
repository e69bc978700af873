"""What a reference photo leads to: the strictest answer that the configuration has, in a sentence with its size."""

import pytest

from recon.scene.scene_change import Finding
from recon.scene.scene_error import ErrorScale
from rig.capture_sections import Watch
from rig.capturing.scene_watch import decide
from rig.config import RigConfig, parse_config
from rig.errors import ConfigError
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene

SLIP = Finding("display", "display", shift_px=0.2, sd_px=0.01)
RIPPLE = Finding("liquid", "display", shift_px=0.2, sd_px=0.01)
DIMMED = Finding("light", "display", light=-0.05)
SCALE = ErrorScale(mm_per_px=0.25, display=8.0, whole=5.0)


def response(*found: Finding, tries_left: bool = True, **settings) -> str:
    return decide(found, Watch(**settings), scale=None, tries_left=tries_left).response


def test_the_capture_goes_on_when_nothing_was_found() -> None:
    outcome = decide((), Watch(), scale=SCALE, tries_left=True)
    assert (outcome.response, outcome.text) == ("go on", "")


def test_each_cause_has_its_own_answer_and_the_strictest_counts() -> None:
    assert response(SLIP) == "stop"
    assert response(RIPPLE) == "retake"
    assert response(DIMMED) == "warn"
    assert response(DIMMED, RIPPLE) == "retake"
    assert response(SLIP, DIMMED, when_moved="warn") == "warn"
    assert response(DIMMED, when_light_changed="stop") == "stop"


def test_a_sweep_is_not_taken_again_for_ever() -> None:
    assert response(RIPPLE, tries_left=False) == "stop"


def test_the_sentence_says_what_moved_how_far_what_it_costs_and_what_to_do() -> None:
    text = decide((SLIP,), Watch(), scale=SCALE, tries_left=True).text
    # 0.2 px · 0.25 mm · 8
    assert text == (
        "the display slipped: its picture moved by 0.20 px (sd 0.010), which puts entry points off by up to about 0.4 mm; "
        "fasten the display on its stage, then resume; if it cannot go back to where it was, start a new session"
    )
    assert "mm" not in decide((SLIP,), Watch(), scale=None, tries_left=True).text
    # The object moved as a whole: 0.2 · 0.25 · 5
    moved = Finding("object", "marks", shift_px=0.2, sd_px=0.01)
    assert "about 0.25 mm" in decide((moved,), Watch(), scale=SCALE, tries_left=True).text


def test_the_outline_of_a_simulated_object_lies_in_the_photo_clear_of_its_marks() -> None:
    options = SceneOptions(camera_columns=200, watch=True)
    config = config_of_scene(open_scene("hemisphere", options), options)
    assert config.watch is not None
    # A ball of 27.99 mm radius 420 mm away through a lens of 2100 · 200 / 320 px, seen a little wider than its equator.
    reach_px = max(abs(x - 99.5) for x, _ in config.watch.object_px)
    assert reach_px == pytest.approx(27.99 / 420 * 1312.5, abs=3)
    assert len(config.watch.marks_px) == 4
    left, top, right, bottom = config.watch.marks_px[3]
    assert 170 < left < right < 200
    assert 170 < top < bottom < 200
    assert config_of_scene(open_scene("hemisphere", SceneOptions()), SceneOptions()).watch is None


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ({"object_px": [[0, 0], [5, 5]]}, "at least three corners"),
        ({"marks_px": [[9, 0, 3, 5]]}, "first column, first row"),
        ({"shift_px": 0}, "greater than 0"),
    ],
)
def test_a_section_that_makes_no_sense_is_refused(config: RigConfig, section: dict, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        parse_config({**config.model_dump(), "watch": section}, source="test")
