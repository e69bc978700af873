"""Many sessions at a time: one that is bad, or that loses its worker, never stops the others."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from batch_example import hashes, killed_worker, make_sessions
from dask_cluster import local_cluster
from report_example import example_maps, example_metrics

from recon.batch.asked_batch import chosen
from recon.batch.batch_record import Batch, recorded_sessions, save_record
from recon.batch.batch_run import Crew, run_batch
from recon.batch.own_processes import OwnProcesses, WorkerLostError
from recon.batch.session_list import sessions_asked
from recon.batch.session_status import Attempt, SessionStatus, load_status, save_status
from recon.batch.stop_signal import StopSignal
from recon.errors import ReconError
from recon.method import Limits
from recon.metrics import METRICS_NAME, save_metrics
from recon.run import run_session
from recon.running.input_hashes import input_hashes
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
            # A copy, so that the batch has to decode its own.
            copy = Path(shutil.copytree(folder, out / "sessions" / folder.name))
            run_session(copy, out / folder.name, Settings())
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
    batch = Batch(tmp_path, recorded_sessions(tmp_path), Settings())
    assert chosen(batch, resume=True, only_failed=False) == []
    assert chosen(batch, resume=False, only_failed=True) == list(BROKEN)
    other = Batch(tmp_path, batch.sessions, Settings(limits=Limits(gap_sigma=4.0)))
    assert chosen(other, resume=True, only_failed=False) == list(batch.sessions)
    assert chosen(other, resume=False, only_failed=True) == []


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


def test_a_session_that_got_another_journal_since_is_not_done(tmp_path: Path) -> None:
    session, out = tmp_path / "cup", tmp_path / "out"
    session.mkdir()
    (session / "manifest.json").write_text("{}")
    (session / "journal.jsonl").write_text("one\n")
    batch = Batch(out, {"cup": session}, Settings())
    save_status(batch.waiting("cup").ended("done"), out / "cup")
    metrics = example_metrics(example_maps(rows=30, cols=40, radius_px=12))
    hashes_now = input_hashes(session, calibration=None)
    save_metrics(metrics.model_copy(update={"hashes": hashes_now}), out / "cup" / METRICS_NAME)
    assert batch.is_done("cup")
    (session / "journal.jsonl").write_text("one\ntwo\n")
    assert not batch.is_done("cup")


def state_of(results: Path) -> str:
    status = load_status(results)
    return status.state if status else "none"


def wait_for(true: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 120
    while not true():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def test_ctrl_c_begins_nothing_new_lets_what_runs_end_and_leaves_a_true_status(sessions: Path, tmp_path: Path) -> None:
    good = [folder for folder in sorted(sessions.iterdir()) if folder.name not in BROKEN]
    # A group of its own, to all of which the signal goes, as a terminal's does.
    process = subprocess.Popen(
        recon("batch", *good, "--out", tmp_path, "--jobs", 1, "--force"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_for(lambda: state_of(tmp_path / good[0].name) == "running")
    os.killpg(process.pid, signal.SIGINT)
    said, complaint = process.communicate(timeout=300)
    assert (process.returncode, complaint) == (130, "")
    assert [state_of(tmp_path / folder.name) for folder in good] == ["done", "waiting"]
    assert "stopping: nothing new is begun, 1 session will be finished; Ctrl-C again ends it at once" in said
    assert f"stopped: 1 done, 1 waiting; to go on: recon batch --resume --out {tmp_path}" in said


def test_ctrl_c_twice_ends_what_runs_and_says_stopped(sessions: Path, tmp_path: Path) -> None:
    good = [folder for folder in sorted(sessions.iterdir()) if folder.name not in BROKEN]
    batch = Batch(tmp_path, {folder.name: folder for folder in good}, Settings(force=True))
    names = list(batch.sessions)
    stop = StopSignal()

    def interrupt() -> None:
        wait_for(lambda: state_of(tmp_path / names[0]) == "running")
        stop.asked = 2

    hand = threading.Thread(target=interrupt)
    hand.start()
    with OwnProcesses(1, threads=1, preload=("recon.run",)) as executor:
        crew = Crew("one process", executor, WorkerLostError, kill=executor.kill)
        found = run_batch(batch, names, crew=crew, stop=stop, on_change=lambda *_: None, on_stop=lambda _: None)
    hand.join()
    assert [found[name].state for name in names] == ["stopped", "waiting"]
    assert [state_of(tmp_path / name) for name in names] == ["stopped", "waiting"]
    with pytest.raises(ProcessLookupError):
        os.kill(found[names[0]].attempts[0].process, 0)
    assert chosen(batch, resume=True, only_failed=False) == names


def test_a_session_that_loses_two_workers_failed_and_names_both() -> None:
    status = SessionStatus(session="cup", state="waiting", batch="b", settings="s")
    for number in (11, 12):
        assert status.state == "waiting"
        status = status.begun(Attempt(host="node", process=number, began="2026-11-26T10:00:00+00:00"))
        status = status.lost("killed by SIGKILL")
    assert status.state == "failed"
    assert status.fault == (
        "lost its worker: process 11 on node (killed by SIGKILL), then process 12 on node (killed by SIGKILL); "
        "it was not tried again"
    )


def test_sessions_are_named_by_folder_by_pattern_and_by_list_each_once(tmp_path: Path) -> None:
    for name in ("monday/cup", "monday/vase", "tuesday/cup"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "monday/notes.txt").write_text("# those of Monday\n\ncup\nvase\n")
    found = sessions_asked([str(tmp_path / "*" / "cup"), str(tmp_path / "monday/notes.txt"), str(tmp_path / "gone")])
    assert found == {
        "monday-cup": tmp_path / "monday/cup",
        "tuesday-cup": tmp_path / "tuesday/cup",
        "vase": tmp_path / "monday/vase",
        "gone": tmp_path / "gone",
    }


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "no session was named"),
        (["nothing/*"], "no folder has a name of this pattern"),
        (["empty.txt"], "lists no session"),
        (["a/x/cup", "b/x/cup"], "would both be called x-cup in the batch; rename one"),
    ],
)
def test_what_names_no_session_is_refused_in_a_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.txt").write_text("# nothing yet\n")
    with pytest.raises(ReconError, match=sentence):
        sessions_asked(arguments)


def test_results_never_go_into_the_sessions_themselves(tmp_path: Path) -> None:
    with pytest.raises(ReconError, match="the results of cup would go into the session itself"):
        save_record(Batch(tmp_path, {"cup": tmp_path / "cup"}, Settings()))


ASK_A_PROCESS = """
from recon.batch.own_processes import OwnProcesses
if __name__ == "__main__":
    with OwnProcesses(1, threads=1, preload=("recon.compiled",)) as processes:
        print(processes.submit(len, "four").result())
"""


def test_a_folder_that_bears_a_librarys_name_does_not_stand_for_it_where_somebody_works(tmp_path: Path) -> None:
    # Numba looks for this library, which is not installed, and takes any folder for it.
    work = tmp_path / "work"
    (work / "coverage").mkdir(parents=True)
    script = tmp_path / "ask.py"
    script.write_text(ASK_A_PROCESS)
    asked = subprocess.run([sys.executable, script], cwd=work, capture_output=True, text=True, check=False)
    assert (asked.stdout, asked.returncode) == ("4\n", 0), asked.stderr
