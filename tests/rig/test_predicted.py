"""`rig plan --predict`: a table of places for the display, and one sentence of advice."""

import pytest

from rig.errors import ConfigError
from rig.planning.predicted import alternatives, recommended
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene


def config_of(scene: str):  # type: ignore[no-untyped-def]  # what config_of_scene returns
    return config_of_scene(open_scene(scene, SceneOptions()), SceneOptions())


def test_every_place_lies_within_the_stages_travel_and_the_configured_one_is_among_them() -> None:
    config = config_of("hemisphere")
    found = alternatives(config, "sphere 27.99", place_sd_px=0.1)
    low_mm, high_mm = config.stage.travel_mm
    assert all(low_mm <= place <= high_mm for one in found for place in one.stage_mm)
    configured = [one for one in found if one.configured]
    assert len(configured) == 1
    assert configured[0].stage_mm == (config.stage.position_0_mm, config.stage.position_1_mm)


def test_the_recommended_place_is_no_worse_than_the_configured_one() -> None:
    found = alternatives(config_of("hemisphere"), "plane 40 20", place_sd_px=0.1)
    best = recommended(found)
    assert best is not None
    now = next(one for one in found if one.configured)
    assert best.prediction.normal_sd_rad <= now.prediction.normal_sd_rad


@pytest.mark.parametrize("text", ["sphere", "sphere -1", "cube 3", "plane 40", "plane 40 95", "sphere x"])
def test_an_object_that_is_none_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(ConfigError, match="give 'sphere RADIUS'"):
        alternatives(config_of("hemisphere"), text, place_sd_px=0.1)


def test_a_thin_object_has_no_crossing_to_predict() -> None:
    with pytest.raises(ConfigError, match="method 'liquid'"):
        alternatives(config_of("thin_cone"), "sphere 10", place_sd_px=0.1)
