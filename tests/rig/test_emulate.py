"""``rig emulate`` as its user meets it: a process whose printed lines other programs can use."""

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path

import pytest
import simplejpeg

from rig.config import RigConfig, load_config
from rig.devices import real_camera, real_pump, real_stage
from rig.tank.flow import POLL_S
from sim_backend.clock import RealClock

ROOT = Path(__file__).parents[2]
# Generous, because continuous integration may be slow; nothing waits that long when all is well.
PATIENCE_S = 60.0
BY_ITSELF = ("--stage", "none", "--pump", "none", "--camera", "none")


@contextlib.contextmanager
def emulating(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Yield the process and what it printed up to the line that says how to end it."""
    command = [sys.executable, "-c", "from rig.cli import main; main()", "emulate", "--size", "64", *arguments]
    with subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            printed = ""
            for line in process.stdout:
                printed += line
                if "Ctrl-C" in line:
                    break
            else:
                pytest.fail(process.communicate()[1])
            yield process, printed
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


def write_config(folder: Path, printed: str) -> Path:
    """Write the template with the printed sections in the place of its own, as a person is told to do it."""
    template = (resources.files("rig") / "template.toml").read_text("utf-8")
    replaced = set(tomllib.loads(printed))
    parts = re.split(r"^(?=\[)", template, flags=re.MULTILINE)
    kept = [part for part in parts if re.match(r"\[?(\w*)", part).group(1) not in replaced]  # type: ignore[union-attr]
    path = folder / "rig.toml"
    path.write_text("".join(kept) + printed, encoding="utf-8")
    return path


def use_stage(config: RigConfig) -> None:
    low_mm, high_mm = config.stage.travel_mm
    with real_stage(config, clock=RealClock()) as stage:
        stage.home(timeout_s=PATIENCE_S)
        target_mm = 0.3 * low_mm + 0.7 * high_mm
        stage.move_to_mm(target_mm, timeout_s=PATIENCE_S)
        assert stage.position_mm() == pytest.approx(target_mm, abs=0.01)


def use_pump(config: RigConfig) -> None:
    pump, _ = real_pump(config)
    with pump:
        pump.start("fill", volume_ml=40.0, max_run_s=PATIENCE_S)
        deadline_s = time.monotonic() + PATIENCE_S
        while pump.status().running:
            assert time.monotonic() < deadline_s
            time.sleep(POLL_S)  # the pace of a capture, which the dead-man timers must bear at any speed of the world
        assert pump.status().moved_ml == pytest.approx(40.0, abs=0.1)
        assert pump.status().alarm == ""


# pyserial's own RFC 2217 client
@pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning", "ignore:setName:DeprecationWarning")
@pytest.mark.parametrize(
    "choice",
    [
        "--stage grbl --pump new_era --camera generic",
        "--stage zaber --pump tank_board --camera canon-eos-40d --tcp",
        "--stage grbl --pump new_era --camera none --rfc2217",
    ],
)
def test_the_drivers_work_on_the_printed_addresses_and_ctrl_c_ends_it(tmp_path: Path, choice: str) -> None:
    with emulating("--speed", "4", *choice.split()) as (process, printed):
        assert printed.startswith("# EMULATED DEVICES. NOTHING HERE IS REAL.")
        assert "must say so" in printed
        config = load_config(write_config(tmp_path, printed))
        use_stage(config)
        use_pump(config)
        if config.devices.camera:
            with real_camera(config) as camera:
                camera.expose(timeout_s=PATIENCE_S)
                (photo,) = camera.collect(timeout_s=PATIENCE_S)
            grey = simplejpeg.decode_jpeg(photo.data, colorspace="GRAY")
            assert grey.shape == (64, 64, 1)
            assert grey.max() > 100, "a white display shows"
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, err) == (0, "")
        assert out == "# The emulated devices are gone.\n"


def test_the_printed_command_lets_debians_gphoto2_take_a_photo(
    tmp_path: Path, require_program: Callable[[str, str], str]
) -> None:
    program = require_program("gphoto2", "gphoto2")
    # A Debian program wants Debian's libraries, and a settings folder of its own.
    environment = {name: value for name, value in os.environ.items() if name not in ("CAMLIBS", "IOLIBS")}
    environment |= {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path), "LC_ALL": "C"}
    with emulating("--stage", "none", "--pump", "none") as (process, printed):
        words = shlex.split(printed.split("# camera: ")[1].splitlines()[0])
        assert words[0] == "gphoto2"
        command = [program, *words[1:], "--filename", "photo.jpg"]
        subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, timeout=PATIENCE_S)
        grey = simplejpeg.decode_jpeg((tmp_path / "photo.jpg").read_bytes(), colorspace="GRAY")
        assert grey.shape == (64, 64, 1)
        process.terminate()
        assert process.wait(PATIENCE_S) == 0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (BY_ITSELF, "at least one of --stage, --pump and --camera"),
        (("--pty", "--tcp"), "choose one of them"),
        (("--scene", "thin_cone"), "add --pump none"),
        (("--scene", "no_such_scene"), "no_such_scene"),
    ],
)
def test_what_cannot_be_emulated_is_refused_in_one_sentence(arguments: tuple[str, ...], sentence: str) -> None:
    command = [sys.executable, "-c", "from rig.cli import main; main()", "emulate", *arguments]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert (ran.returncode, ran.stdout) == (1, "") or (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.startswith("rig: ")
    assert sentence in ran.stderr
    assert ran.stderr.count("\n") == 1


@pytest.mark.slow
def test_the_contract_is_asked_of_a_configured_device_where_it_needs_no_world(tmp_path: Path) -> None:
    """To the suite the emulators look real: it knows nothing of them but their addresses."""
    with emulating("--speed", "4", "--stage", "zaber", "--camera", "generic") as (_, printed):
        config = write_config(tmp_path, printed)
        command = [sys.executable, "-m", "pytest", "tests/contract", "--hardware", str(config), "-m", "hardware", "-rA"]
        # The run that this test is a part of checks shapes; here that would only be put into every module again.
        command += ["-o", "addopts=", "-p", "no:cacheprovider"]
        ran = subprocess.run(
            command,
            cwd=ROOT,
            env={**os.environ, "CI": "true"},
            capture_output=True,
            text=True,
            check=False,
            timeout=180,
        )
    assert ran.returncode == 0, ran.stdout
    for test in (
        "test_stage_contract.py::test_stopping_twice_is_harmless[hardware]",
        "test_pump_contract.py::test_a_second_start_is_refused_while_the_pump_runs[hardware]",
        "test_camera_contract.py::test_a_photo_is_a_whole_file[hardware]",
    ):
        assert f"PASSED tests/contract/{test}" in ran.stdout
    assert "this test looks at the simulated world, and a real device has none" in ran.stdout
    assert "test_display_contract" not in ran.stdout, "no display is configured"
