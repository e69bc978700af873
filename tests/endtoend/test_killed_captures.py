"""A capture that is killed loses nothing that it had acknowledged, and takes nothing twice: a few of the 500 of the bench."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SESSIONS = 20


@pytest.mark.slow
def test_captures_killed_at_random_instants_resume_to_the_photos_of_an_undisturbed_one() -> None:
    command = [sys.executable, "-m", "tests.bench.kill_captures", "--sessions", str(SESSIONS), "--seed", "20"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ran.stderr == ""
    result = json.loads(ran.stdout)
    assert result["sessions_with_faults"] == {}
    assert result["sessions"] == SESSIONS
    assert result["kills"] > SESSIONS  # some were killed while they were resumed
    assert ran.returncode == 0
