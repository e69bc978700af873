"""The process that libgphoto2 lives in: it is ended when it hangs, and never outlives its owner with the camera in its hand."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from emulated_camera import NumberedPhotos

from drivers import camera_process
from drivers.camera_process import CameraFault, CameraProcess, LateFault, RefusedFault, WedgedFault
from sim_backend.ptpip.process import emulate_camera


def wait_until(done: Callable[[], bool], *, timeout_s: float) -> bool:
    end_s = time.monotonic() + timeout_s
    while not done() and time.monotonic() < end_s:
        time.sleep(0.05)
    return done()


def is_running(process_id: int) -> bool:
    try:
        state = Path(f"/proc/{process_id}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_a_library_that_loops_without_end_is_ended_at_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    """libgphoto2 waits for ever for an EOS that reports room for no shot at all."""
    monkeypatch.setattr(camera_process, "GRACE_S", 0.5)
    process = CameraProcess()
    try:
        with emulate_camera(NumberedPhotos(), model="canon-eos-40d") as body:
            body.set_faults(no_shots_left=True)
            with pytest.raises(RefusedFault):
                process.call("nothing", limit_s=10.0)  # it has started
            started_s = time.monotonic()
            with pytest.raises(WedgedFault, match="no answer within 2 s"):
                process.call("open", limit_s=1.5, address=body.address)
            assert 2.0 <= time.monotonic() - started_s < 10.0
            assert not process.alive
    finally:
        process.end()


def test_a_process_that_was_killed_is_a_fault_and_not_a_hang() -> None:
    process = CameraProcess()
    try:
        process._process.kill()
        with pytest.raises(WedgedFault, match="ended"):
            process.call("drain", limit_s=10.0)
    finally:
        process.end()


def test_a_missing_library_is_named(tmp_path: Path) -> None:
    (tmp_path / "gphoto2.py").write_text("raise ModuleNotFoundError('gphoto2 is not here')\n", encoding="utf-8")
    process = CameraProcess(environment={"PYTHONPATH": str(tmp_path)})
    try:
        with pytest.raises(WedgedFault, match="gphoto2 is not here"):
            process.call("open", limit_s=10.0, address="usb:")
    finally:
        process.end()


def test_an_operation_that_does_not_exist_is_refused() -> None:
    process = CameraProcess()
    try:
        with pytest.raises(RefusedFault, match="'begin' does not exist"):
            process.call("begin", limit_s=10.0)
    finally:
        process.end()


def test_what_is_late_and_what_failed_are_told_apart() -> None:
    process = CameraProcess()
    try:
        with emulate_camera(NumberedPhotos(), exposure_s=0.5) as body:
            process.call("open", limit_s=20.0, address=body.address)
            with pytest.raises(LateFault):
                process.call("expose", limit_s=0.1, files=1, deletes=False)
            with pytest.raises(CameraFault) as found:
                process.call("collect", limit_s=10.0, paths=[("/", "nowhere.jpg")])
        assert found.value.code == -108  # GP_ERROR_FILE_NOT_FOUND
    finally:
        process.end()


def test_ending_twice_is_harmless_and_leaves_no_folder_behind() -> None:
    process = CameraProcess()
    folder = Path(process._settings_folder)
    assert folder.is_dir()
    process.end()
    process.end()
    assert not folder.exists()


def test_the_library_goes_when_its_owner_is_killed() -> None:
    script = (
        "import os, signal\n"
        "from drivers.camera_process import CameraProcess\n"
        "process = CameraProcess()\n"
        "print(process._process.pid, process._settings_folder, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    process_id, folder = ran.stdout.split()
    assert ran.returncode == -9
    assert wait_until(lambda: not is_running(int(process_id)), timeout_s=10.0)
    os.rmdir(folder)
