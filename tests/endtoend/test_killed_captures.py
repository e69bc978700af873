"""A capture that is killed or loses its power keeps all that it had acknowledged: a few of the many that the benches try."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


def ran(script: str, *arguments: str) -> dict[str, Any]:
    command = [sys.executable, "-m", f"tests.bench.{script}", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    result = json.loads(done.stdout)
    assert done.returncode == bool(result["sessions_with_faults"])
    return result


def tried(script: str, *arguments: str) -> dict[str, Any]:
    result = ran(script, *arguments)
    assert result["sessions_with_faults"] == {}
    return result


@pytest.mark.slow
def test_captures_killed_at_random_instants_resume_to_the_photos_of_an_undisturbed_one() -> None:
    result = tried("kill_captures", "--sessions", "20", "--seed", "20")
    assert result["sessions"] == 20
    assert result["kills"] > 20  # some were killed while they were resumed


@pytest.mark.slow
def test_a_capture_through_real_drivers_that_is_killed_finds_the_devices_as_it_left_them(
    require_module: Callable[[str, str], ModuleType],
) -> None:
    require_module("gphoto2", "gphoto2")
    result = tried("kill_wire_captures", "--sessions", "1", "--seed", "3")
    assert result["kills"] >= 1


@pytest.mark.slow
def test_captures_that_lost_their_power_resume_to_the_photos_of_an_undisturbed_one() -> None:
    result = tried("cut_power", "--sessions", "12", "--seed", "12")
    assert result["power_cuts"] >= 12
    assert result["kills_before"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("left_out", ["flush", "flush_folder"])
def test_without_either_kind_of_flush_photos_would_be_lost(left_out: str) -> None:
    result = ran("cut_power", "--sessions", "6", "--seed", "12", "--without", left_out)
    assert len(result["sessions_with_faults"]) >= 2
