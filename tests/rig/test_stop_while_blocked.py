"""A second Ctrl-C ends a capture whichever device never returns from a call; pump and stage stand still.

Calls to the pump and to the stage's stop are not among these: they end by the deadlines of their serial line
(``tests/drivers``), and nothing may end a stop before that.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

# Generous, because continuous integration may be slow; nothing waits that long when all is well.
PATIENCE_S = 60.0
# A capture on the room's clock, one of whose devices hangs in one of its calls like a C library that waits for a wire.
PROGRAM = """
import dataclasses, select, sys
from pathlib import Path
from rich.console import Console
from rig.capturing.capture import capture
from rig.devices import simulated_devices
from rig.rehearsing.rehearsal import Simulation, open_world
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.errors import CaptureStopped
from sim_backend.photography import Photographer

part, method = sys.argv[1:]
options = SceneOptions(camera_columns=32, display_columns=32, step_px=4.0)
scene = open_scene("semi_ellipsoid", options)
config = config_of_scene(scene, options)
config = config.model_copy(update={
    "timing": config.timing.model_copy(update={"photo_s": 0.01, "settle_s": 0.0, "still_after_move_s": 0.0}),
    "stage": config.stage.model_copy(update={"velocity_mm_per_s": 1000.0})})

class Hangs:
    def __init__(self, device):
        self._device = device

    def __getattr__(self, name):
        if name != method:
            return getattr(self._device, name)

        def never(*args, **kwargs):
            print("hangs", flush=True)
            select.select([], [], [])

        return never

with open_world(config, Simulation(scene, real_time=True)) as world:
    devices = simulated_devices(config, world, Photographer(scene))
    devices = dataclasses.replace(devices, **{part: Hangs(getattr(devices, part))})
    try:
        capture(config, Path("s"), devices=devices, scene=scene, resume=False, console=Console(quiet=True))
    except CaptureStopped as stopped:
        print(stopped, flush=True)
        print("pump", world.flow_direction(), "moving", world.is_moving(), flush=True)
"""


def end(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Press Ctrl-C twice, as a person would."""
    process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    return process.communicate(timeout=PATIENCE_S)


@pytest.mark.parametrize(
    ("part", "method"),
    [
        ("display", "screen"),
        ("display", "show"),
        ("camera", "settings"),
        ("camera", "expose"),
        ("camera", "collect"),
        ("stage", "home"),
        ("stage", "position_mm"),
    ],
)
def test_a_second_ctrl_c_does_not_wait_for_a_call_that_hangs(part: str, method: str, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, part, method], cwd=tmp_path, text=True, stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "hangs\n"
    out, _ = end(process)
    assert "pump and stage stand still" in out
    if (part, method) != (
        "pump",
        "status",
    ):  # there it is the pump itself that hangs, and its dead man's switch ends the flow
        assert out.endswith("pump None moving False\n")
    events = [json.loads(line)["event"] for line in (tmp_path / "s/journal.jsonl").read_text().splitlines()]
    assert events[-2:] == ["came_to_rest", "capture_interrupted"]


def test_a_second_ctrl_c_does_not_wait_for_a_camera_that_is_frozen(
    require_program: Callable[[str, str], str], tmp_path: Path
) -> None:
    """The real driver and libgphoto2 wait for a camera whose process was stopped in the middle of a sweep."""
    require_program("chromium", "chromium")
    command = "from rig.cli import main; main()"
    arguments = ("capture", "--sim-wire", "--session", "s", "--size", "32", "--display-columns", "48", "--step-px", "4")
    process = subprocess.Popen(
        [sys.executable, "-c", command, *arguments, "--real-time"],
        cwd=tmp_path,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    journal = tmp_path / "s/journal.jsonl"
    deadline_s = time.monotonic() + PATIENCE_S
    while not (journal.exists() and '"photo"' in journal.read_text()):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    bodies = [pid for pid in children_of(process.pid) if "sim_backend.ptpip" in command_line(pid)]
    assert bodies
    for pid in bodies:
        os.kill(pid, signal.SIGSTOP)
    try:
        time.sleep(1.0)
        _, err = end(process)
    finally:
        for pid in bodies:
            if command_line(pid):
                os.kill(pid, signal.SIGCONT)
    assert process.returncode == 130
    assert "pump and stage stand still" in err


def children_of(pid: int) -> list[int]:
    return [
        int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()
    ]


def command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8").replace("\0", " ")
    except OSError:
        return ""
