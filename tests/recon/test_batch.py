"""Many sessions at a time: one that is bad, or that loses its worker, never stops the others."""

import csv
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from batch_example import hashes, killed_worker, make_sessions
from dask_cluster import local_cluster

from recon.batch.session_status import load_status
from recon.run import run_session
from recon.running.settings import Settings

BROKEN = ("broken-manifest", "lost-photo")


def recon(*arguments: object) -> list[str]:
    return [sys.executable, "-c", "from recon.cli import main; main()", *map(str, arguments)]


def ran(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(recon(*arguments), capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sessions")
    make_sessions(folder, good=2, size=48, display_columns=96)
    return folder


@pytest.fixture(scope="module")
def alone(sessions: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """The hashes of what each good session comes to when it is run by itself."""
    out = tmp_path_factory.mktemp("alone")
    found = {}
    for folder in sorted(sessions.iterdir()):
        if folder.name not in BROKEN:
            run_session(folder, out / folder.name, Settings())
            found[folder.name] = hashes(out / folder.name)
    return found


def check_batch(done: subprocess.CompletedProcess[str], out: Path, alone: dict[str, dict[str, str]]) -> None:
    """The good sessions are done, as if each had been run by itself, one of them at the second attempt; the others are named."""
    assert done.returncode == 1, done.stderr
    assert "recon: 2 of 4 sessions failed: broken-manifest and lost-photo; see why in" in done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    assert {name: hashes(out / name) for name in alone} == alone
    statuses = {name: load_status(out / name) for name in (*alone, *BROKEN)}
    victim, *others = alone
    assert [one.end for one in statuses[victim].attempts] == ["lost", "done"]
    assert all(len(statuses[name].attempts) == 1 for name in (*others, *BROKEN))
    assert "manifest.json: not JSON" in statuses["broken-manifest"].fault
    assert "0003.jpg" in statuses["lost-photo"].fault
    with (out / "batch.csv").open(newline="") as file:
        rows = {row["session"]: row for row in csv.DictReader(file)}
    assert {name: row["state"] for name, row in rows.items()} == dict.fromkeys(alone, "done") | dict.fromkeys(
        BROKEN, "failed"
    )
    page = (out / "batch.html").read_text()
    assert page.index("broken-manifest") < page.index(victim)


def test_on_this_machine_the_good_ones_are_done_and_the_broken_ones_named(
    sessions: Path, alone: dict[str, dict[str, str]], tmp_path: Path
) -> None:
    victim = next(iter(alone))
    with killed_worker(tmp_path / victim):
        done = ran("batch", f"{sessions}/*", "--out", tmp_path, "--jobs", 2)
    check_batch(done, tmp_path, alone)
    assert f"{victim}; lost its worker: process" in done.stdout
    assert "(killed by SIGKILL, as the system does when memory runs out); tried again" in done.stdout


def test_on_a_cluster_the_very_same_comes_out(
    sessions: Path,
    alone: dict[str, dict[str, str]],
    tmp_path: Path,
    require_module: Callable[[str, str], ModuleType],
) -> None:
    require_module("distributed", "distributed")
    out, logs = tmp_path / "out", tmp_path / "logs"
    logs.mkdir()
    victim = next(iter(alone))
    with local_cluster(logs, workers=2) as address, killed_worker(out / victim):
        done = ran("batch", f"{sessions}/*", "--out", out, "--scheduler", address)
    check_batch(done, out, alone)
    assert "lost its worker: process" in done.stdout
