"""Looking at a result: pictures without a window, and one clear sentence where there can be none."""

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import typer
from matplotlib.image import imread
from report_example import example_maps, example_mesh
from typer.testing import CliRunner

from recon.errors import MissingProgramError, ReconError
from recon.maps import save_maps
from recon.surface.files import write_mesh_ply
from recon.surface.mesh import Mesh
from recon.view import What, check_renderer, register, view


@cache
def renderer_fault() -> str:
    try:
        check_renderer()
    except MissingProgramError as error:
        return str(error)
    return ""


def needs_renderer() -> None:
    if renderer_fault():
        pytest.skip(renderer_fault())


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    maps = example_maps()
    vertices_mm, faces, normal = example_mesh(maps)
    save_maps(maps, folder / "maps.npz")
    write_mesh_ply(folder / "mesh.ply", Mesh(vertices_mm, faces.astype(np.int32), normal))
    return folder


@pytest.mark.parametrize("what", ["cloud", "mesh", "normals"])
def test_writes_a_picture_with_the_object_on_white(what: What, result: Path, tmp_path: Path) -> None:
    needs_renderer()
    picture = tmp_path / f"{what}.png"
    view(result, what=what, screenshot=picture)
    brightness = imread(picture)[..., :3].mean(axis=-1)
    # The cap is as high as it is wide: fitted into a picture of 4 to 3 it covers part of it and leaves the corners white.
    assert 0.05 < (brightness < 0.95).mean() < 0.75
    assert (brightness[:20, :20] == 1.0).all()


def test_the_command_prints_where_the_picture_is(result: Path, tmp_path: Path) -> None:
    needs_renderer()
    app = typer.Typer()
    register(app)
    app.command("other")(lambda: None)
    picture = tmp_path / "picture.png"
    ended = CliRunner().invoke(app, ["view", str(result), "--screenshot", str(picture)])
    assert ended.exit_code == 0, ended.output
    assert ended.output.split() == [str(picture)]
    assert picture.is_file()


def test_names_the_package_to_install_when_the_renderer_crashes() -> None:
    crash = (sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(MissingProgramError, match=r"ended with code -11.*apt-get install libegl1 libosmesa6"):
        check_renderer(crash)


def test_names_the_reason_when_the_drawing_library_cannot_be_loaded() -> None:
    fails = (sys.executable, "-c", "raise ImportError('libGL.so.1: cannot open shared object file')")
    with pytest.raises(MissingProgramError, match=r"libGL\.so\.1: cannot open shared object file"):
        check_renderer(fails)


def test_does_not_wait_for_ever_for_a_renderer_that_hangs() -> None:
    hangs = (sys.executable, "-c", "import time; time.sleep(60)")
    with pytest.raises(MissingProgramError, match="took more than 1 s"):
        check_renderer(hangs, limit_s=1.0)


def test_asks_for_a_screenshot_where_there_is_no_screen(result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ReconError, match="no screen to open a window on; write a picture with --screenshot"):
        view(result, what="cloud")


def test_says_what_to_do_when_the_folder_has_no_result(tmp_path: Path) -> None:
    with pytest.raises(ReconError, match=r"no mesh\.ply here; run `recon run` first"):
        view(tmp_path, screenshot=tmp_path / "picture.png")
    with pytest.raises(ReconError, match=r"maps\.npz: no such file; run `recon run`"):
        view(tmp_path, what="cloud", screenshot=tmp_path / "picture.png")


def test_refuses_a_picture_that_is_not_png(result: Path, tmp_path: Path) -> None:
    with pytest.raises(ReconError, match=r"give a name that ends in \.png"):
        view(result, screenshot=tmp_path / "picture.jpg")
