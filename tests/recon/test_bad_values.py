"""A value that is not what it should be: a person reads which and why, in no terms of the program's own checks."""

import copy
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from command_run import Done
from session_example import manifest, write_session

from recon.errors import ReconError, SessionError
from recon.sessions.session import parse_manifest
from recon.study.catalogue import EXPERIMENTS
from recon.study.command import write_page

# What pydantic, which checks values, says of them.
JARGON = re.compile(
    r"Input should|Value error|Field required|Extra inputs|instance of|Unable to|validation|valid (number|string)"
)
OPTIONS: list[tuple[tuple[str, ...], str]] = [
    (("run", "SESSION", "--method", "best"), "Invalid value for '--method': 'best' is not one of 'paper', 'full'."),
    (("run", "SESSION", "--threads", "-1"), "Invalid value for '--threads': must be 0 or more, found '-1'."),
    (("run", "SESSION", "--threads", "some"), "Invalid value for '--threads': must be a whole number, found 'some'."),
    (("run", "SESSION", "--threads", "1.5"), "Invalid value for '--threads': must be a whole number, found '1.5'."),
    (("run", "SESSION", "--smallest-angle-deg", "500"), "'--smallest-angle-deg': must be 90 or less, found '500'."),
    (("run", "SESSION", "--gap-sigma", "nan"), "Invalid value for '--gap-sigma': must be 0 or more, found 'nan'."),
    (("bench", "--photos", "x"), "Invalid value for '--photos': must be a whole number, found 'x'."),
    (("bench", "--photos", "1"), "Invalid value for '--photos': must be 32 or more, found '1'."),
    (("evaluate", "SESSION", "--primitive", "cube"), "'cube' is not one of 'sphere', 'planes', 'cylinder'."),
]


@pytest.mark.parametrize(("arguments", "said"), OPTIONS, ids=[" ".join(case[0]) for case in OPTIONS])
def test_a_wrong_value_of_an_option_is_refused_in_plain_words(
    arguments: tuple[str, ...], said: str, recon: Callable[..., Done]
) -> None:
    done = recon(*arguments)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(said)
    assert not JARGON.search(done.stderr)


def values(data: Any, above: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield where each value of a manifest stands."""
    inside = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in inside:
        yield (*above, key)
        yield from values(value, (*above, key))


def spoilt(data: dict[str, Any], place: tuple[str | int, ...], change: Callable[[Any, Any], None]) -> dict[str, Any]:
    new = copy.deepcopy(data)
    holder: Any = new
    for key in place[:-1]:
        holder = holder[key]
    change(holder, place[-1])
    return new


@pytest.mark.parametrize("bad", [None, -1, 1.5, 1e308, "x", "", float("nan"), [], {}, [1, 2], {"a": 1}], ids=repr)
def test_any_value_of_a_manifest_may_be_wrong(bad: object) -> None:
    refusals = []
    for place in values(manifest()):
        text = json.dumps(spoilt(manifest(), place, lambda holder, key: holder.__setitem__(key, bad)))
        try:
            parse_manifest(text, source="manifest.json")
        except SessionError as error:
            refusals.append(str(error))
    assert [text for text in refusals if JARGON.search(text) or "\n" in text] == []
    assert len(refusals) > 80  # of 130 values; some may be any text, any number or absent


@pytest.mark.parametrize(("bad", "written"), [(None, "null"), (True, "true"), (False, "false"), (-1.5, "-1.5")])
def test_a_wrong_value_is_told_as_it_stands_in_the_file(bad: object, written: str) -> None:
    text = json.dumps(spoilt(manifest(), ("length_unit",), lambda holder, key: holder.__setitem__(key, bad)))
    with pytest.raises(SessionError, match=f"length_unit: must be .*, found {written}$"):
        parse_manifest(text, source="manifest.json")


def test_a_value_that_is_missing_or_misspelt_is_named(tmp_path: Path, refusal: Callable[..., str]) -> None:
    without = spoilt(manifest(), ("display", "pitch_mm"), lambda holder, key: holder.pop(key))
    session = write_session(tmp_path / "without", fields=without)
    assert "manifest.json: display.pitch_mm: is missing" in refusal("validate", session)
    extra = spoilt(manifest(), ("display", "pich_mm"), lambda holder, key: holder.update({key: 1.0}))
    session = write_session(tmp_path / "extra", fields=extra)
    assert "manifest.json: display.pich_mm: there is no such value; check the spelling" in refusal("validate", session)


def test_a_damaged_study_is_named_and_not_printed_whole(tmp_path: Path) -> None:
    experiment = EXPERIMENTS[0]
    (tmp_path / f"{experiment.name}.json").write_text('{"name": "some long text" and no more', encoding="utf-8")
    with pytest.raises(ReconError, match="not the result of a study") as caught:
        write_page(tmp_path, EXPERIMENTS)
    assert "some long text" not in str(caught.value)
