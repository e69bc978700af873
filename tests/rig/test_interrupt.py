"""Real signals to real processes: the session stays whole, the pump is off, and the capture goes on later."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from recon.sessions.session import SessionWriter, open_session
from rig.capturing.session_manifest import SIMULATED_DEVICE, manifest_of
from rig.config import RigConfig
from rig.planning.plan import all_photos, set_name, set_order
from rig.rehearsing.simulate import take
from sim_backend.photography import Photographer
from sim_backend.scene import Scene
from sim_backend.world_file import load_state

# Generous, because continuous integration may be slow; nothing waits that long when all is well.
PATIENCE_S = 60.0


def start_rig(*arguments: str, folder: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", "from rig.cli import main; main()", *arguments]
    return subprocess.Popen(command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def journal_text(session: Path) -> str:
    path = session / "journal.jsonl"
    return path.read_text() if path.exists() else ""


@pytest.fixture
def begin(tmp_path: Path, config: RigConfig, scene: Scene) -> Callable[..., Path]:
    """Return ``begin(conditions)``: a session with the sets of these conditions, to be resumed on a rig that is quick."""

    def begun(*conditions: str) -> Path:
        timing = config.timing.model_copy(update={"still_after_move_s": 0.0, "photo_s": 0.05, "settle_s": 0.0})
        stage = config.stage.model_copy(update={"velocity_mm_per_s": 1000.0})
        assert config.tank is not None
        tank = config.tank.model_copy(update={"pump_rate_ml_per_min": 60_000.0})
        quick = config.model_copy(update={"timing": timing, "stage": stage, "tank": tank})
        photographer = Photographer(scene)
        places = {set_name(place): place for place in set_order(quick)}
        folder = tmp_path / "session"
        with SessionWriter.create(folder, manifest_of(quick, devices={"rig": SIMULATED_DEVICE}, scene=scene)) as writer:
            for photo in all_photos(quick):
                place = places[photo.set_name]
                if place[1] in conditions:
                    data = take(photo, place, photographer, quick)
                    writer.save_photo(data, set_name=photo.set_name, sweep=photo.sweep, index=photo.index)
        return folder

    return begun


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["ctrl-c", "terminate"])
def test_an_interrupt_among_photos_leaves_a_session_that_resumes_to_the_same_bytes(
    tmp_path: Path, begin, captured, read_photo_bytes, number: signal.Signals
) -> None:
    session = begin()
    process = start_rig("capture", "--resume", "--session", "session", "--sim", "--real-time", folder=tmp_path)
    wait_for(lambda: '"photo"' in journal_text(session), process)
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert err.startswith("rig: stopped with ")
    assert err.endswith("go on with `rig capture --resume --session session --sim`\n")
    assert err.count("\n") == 1
    assert "stopping after this photo" in out
    done = len(open_session(session).photos)
    assert 1 <= done < 72
    resumed = start_rig("capture", "--resume", "--session", "session", "--sim", folder=tmp_path)
    out, err = resumed.communicate(timeout=PATIENCE_S)
    assert (resumed.returncode, err) == (0, "")
    assert out == (
        f"session: {done} of 72 photos are whole, {72 - done} to be taken\n"
        f"session: 72 photos, {72 - done} of them taken now\n"
    )
    assert read_photo_bytes(session) == read_photo_bytes(captured)


def test_an_interrupt_during_the_fill_stops_the_pump(tmp_path: Path, begin) -> None:
    dry_half = begin("air")
    process = start_rig(
        "capture", "--resume", "--session", "session", "--sim", "--real-time", "--state", "bench.json", folder=tmp_path
    )
    wait_for(lambda: '"fill_started"' in journal_text(dry_half), process)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "pump and stage stand still" in err
    entries = [json.loads(line) for line in journal_text(dry_half).splitlines()]
    assert [entry["event"] for entry in entries[-4:]] == [
        "fill_started",
        "fill_stopped",
        "came_to_rest",
        "capture_interrupted",
    ]
    tank_ml = load_state(tmp_path / "bench.json").tank_ml
    assert 0 < tank_ml < 4000
    assert entries[-3]["tank_ml"] == pytest.approx(tank_ml)
    # The next run asks the tank, and pumps only what is missing.
    resumed = start_rig(
        "capture", "--resume", "--session", "session", "--sim", "--state", "bench.json", folder=tmp_path
    )
    assert resumed.communicate(timeout=PATIENCE_S)[1] == ""
    fills = [json.loads(line) for line in journal_text(dry_half).splitlines() if '"fill_started"' in line]
    assert fills[-1]["volume_ml"] == pytest.approx(4000 - tank_ml)
    assert len(open_session(dry_half).photos) == 72


def test_an_interrupt_stops_a_pump_that_was_started_by_hand(tmp_path: Path) -> None:
    arguments = ("pump", "fill", "3000", "--sim", "--real-time", "--state", "bench.json")
    # Imports take seconds on a busy machine, and only then does anyone listen to signals.
    program = [sys.executable, "-c", "from rig.cli import main; print(flush=True); main()"]
    process = subprocess.Popen(
        [*program, *arguments], cwd=tmp_path, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(2.5)
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert err.startswith("rig: ")
    assert 0 < load_state(tmp_path / "bench.json").tank_ml < 3000


def test_a_tank_holds_what_was_pumped_when_the_program_was_killed(tmp_path: Path) -> None:
    """The next command finds the pump running, as a real driver would, stops it, and the liquid is where it was."""
    bench = tmp_path / "bench.json"
    begun_s = time.monotonic()
    process = start_rig("pump", "fill", "3000", "--sim", "--real-time", "--state", "bench.json", folder=tmp_path)
    wait_for(lambda: bench.exists() and load_state(bench).flow is not None, process)
    time.sleep(1.0)
    process.kill()
    process.communicate(timeout=PATIENCE_S)
    longest_s = time.monotonic() - begun_s
    assert process.returncode == -signal.SIGKILL
    assert load_state(bench).flow is not None
    after = start_rig("pump", "status", "--sim", "--state", "bench.json", folder=tmp_path)
    out, err = after.communicate(timeout=PATIENCE_S)
    assert (after.returncode, err) == (0, "")
    assert out.startswith("pump: stands still\n")
    state = load_state(bench)
    assert state.flow is None
    rate_ml_per_s = 20.0  # of the simulated pump, 1200 ml a minute
    assert 0.5 * rate_ml_per_s < state.tank_ml < rate_ml_per_s * longest_s
    assert state.tank_ml + state.reservoir_ml == pytest.approx(4200.0)


def test_a_second_ctrl_c_stops_at_once(tmp_path: Path, begin) -> None:
    """A stage that creeps for minutes does not look up between the two; the second Ctrl-C does not wait for it."""
    dry_half = begin("air")
    manifest = json.loads((dry_half / "manifest.json").read_text())
    manifest["provenance"]["configuration"]["rig"]["stage"]["velocity_mm_per_s"] = 0.01
    (dry_half / "manifest.json").write_text(json.dumps(manifest))
    process = start_rig(
        "capture", "--resume", "--session", "session", "--sim", "--real-time", "--state", "bench.json", folder=tmp_path
    )
    wait_for(lambda: '"homing_started"' in journal_text(dry_half), process)
    process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "stopped with 36 of 72 photos" in err
    assert '"came_to_rest"' in journal_text(dry_half).splitlines()[-2]
