"""Debian's own gphoto2 command photographs with the emulated cameras: a judge that knows nothing of this project."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import simplejpeg

from sim_backend.ptpip.process import MODELS


@pytest.fixture(params=MODELS)
def address(request: pytest.FixtureRequest) -> Iterator[str]:
    """The address of a camera that runs by itself, as ``python -m sim_backend.ptpip`` prints it."""
    command = [sys.executable, "-m", "sim_backend.ptpip", "--model", request.param, "--port", "0", "--exposure-s", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        words = process.stdout.readline().split()
        try:
            yield words[words.index("--port") + 1]
        finally:
            process.terminate()


@pytest.fixture
def gphoto2(require_program: Callable[[str, str], str], address: str, tmp_path: Path) -> Callable[..., str]:
    program = require_program("gphoto2", "gphoto2")
    # A Debian program wants Debian's libraries, and a settings folder of its own.
    environment = {name: value for name, value in os.environ.items() if name not in ("CAMLIBS", "IOLIBS")}

    def run(*arguments: str) -> str:
        ran = subprocess.run(
            [program, "--port", address, "--camera", "PTP/IP Camera", *arguments],
            cwd=tmp_path,
            env={**environment, "HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path), "LC_ALL": "C"},
            capture_output=True,
            text=True,
            timeout=60.0,
            check=False,
        )
        assert ran.returncode == 0, ran.stderr
        return ran.stdout

    return run


def test_capture_and_download(gphoto2: Callable[..., str], tmp_path: Path) -> None:
    gphoto2("--capture-image-and-download", "--filename", "photo.jpg")
    assert simplejpeg.decode_jpeg((tmp_path / "photo.jpg").read_bytes(), colorspace="GRAY").shape == (432, 648, 1)


def test_settings_and_summary(gphoto2: Callable[..., str]) -> None:
    assert "EMULATED" in gphoto2("--summary")
    gphoto2("--set-config-value", "iso=200")
    assert "Current: 200" in gphoto2("--get-config", "iso")
