"""The configuration file: every value explained, every wrong one refused with its key and line."""

import tomllib
from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from rig.config import RigConfig, line_of, load_config, parse_config
from rig.errors import ConfigError
from rig.planning.plan import plan_capture, summarise

TEMPLATE = (resources.files("rig") / "template.toml").read_text("utf-8")


def config_file(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_template_is_a_configuration_that_can_be_planned(tmp_path: Path) -> None:
    config = load_config(config_file(tmp_path, TEMPLATE))
    # 400 … 1600 in steps of 4 are 301 columns, 300 … 1200 are 226 rows; white, black; four sets; 4 + 3 · 3 reference photos
    assert summarise(plan_capture(config), config).photos == 4 * (301 + 226 + 2) + 4 + 3 * 3


@pytest.mark.parametrize("given", ["cal/calibration.json", "/somewhere/calibration.json"])
def test_a_calibration_is_looked_for_beside_the_configuration_and_not_where_the_command_runs(
    tmp_path: Path, given: str
) -> None:
    text = TEMPLATE.replace('# calibration = "calibration.json"', f'calibration = "{given}"')
    config = load_config(config_file(tmp_path, text))
    assert config.calibration == str(tmp_path / given)


def leaves(model: type[BaseModel]) -> set[str]:
    names = set()
    for name, field in model.model_fields.items():
        parts = [field.annotation, *getattr(field.annotation, "__args__", ())]
        inner = [part for part in parts if isinstance(part, type) and issubclass(part, BaseModel)]
        names |= leaves(inner[0]) if inner else {name}
    return names


def test_the_template_names_every_value_there_is() -> None:
    for name in leaves(RigConfig):
        assert f"{name} =" in TEMPLATE or f".{name}]" in TEMPLATE, name


@pytest.mark.parametrize(
    ("old", "new", "line_holds", "said"),
    [
        ("pitch_mm = 0.0962", "pitch_mm = -1", "pitch_mm", "display.pitch_mm: must be greater than 0, found -1"),
        ("pitch_mm = 0.0962", "pich_mm = 0.0962", "[display]", "display.pitch_mm: is missing"),
        ('note = ""', 'colour = ""', "colour", "object.colour: there is no such value; check the spelling"),
        ("fill_ml = 4500.0", "fill_ml = 6500.0", "[tank]", "tank: fill_ml is 6500, the tank's free_volume_ml is 6000"),
        ("reservoir_ml = 5000.0", "reservoir_ml = 9000.0", "[tank]", "would flood the room"),
        ("reservoir_ml = 5000.0", "reservoir_ml = 4000.0", "[tank]", "less than fill_ml of 4500"),
        ("position_1_mm = 60.0", "position_1_mm = 160.0", "[stage]", "position_1_mm is 160, travel_mm is 0 to 100"),
        ("position_1_mm = 60.0", "position_1_mm = 20.0", "[stage]", "they must differ"),
        (
            'profile = "raised_cosine"',
            'profile = "round"',
            "profile",
            "must be 'hard' or 'raised_cosine', found 'round'",
        ),
        ("width_px = 12.0", "width_px = nan", "width_px", "capture.stripe.width_px"),
        ('order = "one_fill"', 'order = "two"', 'order = "two"', "capture.order"),
        (
            "centre_mm = [0.0, 0.0, 100.0]",
            "centre_mm = [0.0, 0.0]",
            "centre_mm = [0.0, 0.0]",
            "display_poses.1.centre_mm",
        ),
    ],
)
def test_a_wrong_value_is_refused_with_its_key_and_its_line(
    tmp_path: Path, old: str, new: str, line_holds: str, said: str
) -> None:
    assert old in TEMPLATE
    text = TEMPLATE.replace(old, new)
    with pytest.raises(ConfigError) as caught:
        load_config(config_file(tmp_path, text))
    message = str(caught.value)
    assert said in message
    assert "\n" not in message
    number = int(message.split("line ")[1].split(":")[0])
    assert line_holds in text.splitlines()[number - 1]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "last_column_px = 1600.0",
            "last_column_px = 2048.0",
            "last_column_px is 2048, the display's last column is 2047",
        ),
        ("last_row_px = 1200.0", "last_row_px = 303.0", "a sweep needs at least 3"),
        ('method = "liquid"', 'method = "thin"', "needs the object's refractive index"),
    ],
)
def test_values_that_do_not_fit_together_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(ConfigError, match=r"rig\.toml") as caught:
        load_config(config_file(tmp_path, TEMPLATE.replace(old, new)))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"), [("name = ", "not TOML"), ("name = 1\nname = 2", "not TOML"), ("\0", "not TOML")]
)
def test_what_is_not_toml_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        load_config(config_file(tmp_path, text))


def test_a_file_that_does_not_exist_is_refused_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no such file; write one with `rig init .*--sim"):
        load_config(tmp_path / "absent.toml")


@given(first=st.integers(0, 500), span=st.integers(2, 500), parts=st.sampled_from([1, 2, 3, 7, 10, 64]))
def test_the_last_place_is_reached_though_the_step_does_not_add_up_exactly(first: int, span: int, parts: int) -> None:
    """``span`` in steps of ``1/parts`` device pixel has ``span × parts + 1`` places, as anybody counts on paper."""
    data = tomllib.loads(TEMPLATE)
    data["capture"]["stripe"]["step_px"] = 1 / parts
    data["capture"]["swept"] |= {"first_column_px": first, "last_column_px": first + span}
    assert parse_config(data, source="test").pattern("x").count == span * parts + 1


def test_a_line_is_found_in_nested_tables_and_dotted_keys() -> None:
    text = "[a]\nb.c = 1\n[a.d]\ne = 2\n[[f]]\ng = 3\n[[f]]\ng = 4\n# h = 5\n"
    assert line_of(text, ["a", "b", "c"]) == 2
    assert line_of(text, ["a", "d", "e"]) == 4
    assert line_of(text, ["a", "d", "missing"]) == 3
    assert line_of(text, ["f", "1", "g"]) == 8
    assert line_of(text, ["h"]) is None
