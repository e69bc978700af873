"""A rig small enough to capture within a second: 32 × 32 photos, a display of 32 columns, 8 places a sweep, a fast pump."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from rich.console import Console

from rig.capturing.capture import capture
from rig.cli import main
from rig.config import RigConfig
from rig.devices import Devices, open_devices, simulated_devices
from rig.rehearsing.rehearsal import Simulation, open_world
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.photography import Photographer
from sim_backend.scene import Scene
from sim_backend.world import World

TINY = SceneOptions(camera_columns=32, display_columns=32, step_px=4.0)
# The pump is watched four times a second: a tank that is full in 20 s is as good a test as one that takes minutes.
PUMP_RATE_ML_PER_MIN = 12000.0
TINY_ARGUMENTS = ("--size", "32", "--display-columns", "32", "--step-px", "4")


@pytest.fixture(scope="session")
def tiny_options() -> SceneOptions:
    return TINY


@pytest.fixture(scope="session")
def tiny_arguments() -> tuple[str, ...]:
    return TINY_ARGUMENTS


@pytest.fixture(scope="session")
def scene() -> Scene:
    return open_scene("semi_ellipsoid", TINY)


@pytest.fixture(scope="session")
def thin_scene() -> Scene:
    return open_scene("thin_cone", TINY)


@pytest.fixture(scope="session")
def config(scene: Scene) -> RigConfig:
    config = config_of_scene(scene, TINY)
    assert config.tank is not None
    return config.model_copy(
        update={"tank": config.tank.model_copy(update={"pump_rate_ml_per_min": PUMP_RATE_ML_PER_MIN})}
    )


@pytest.fixture(scope="session")
def thin_config(thin_scene: Scene) -> RigConfig:
    return config_of_scene(thin_scene, TINY)


@pytest.fixture(autouse=True)
def own_state_folder(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Keep what a test learns of its liquid out of the user's own folder, and from the next test."""
    folder = tmp_path_factory.mktemp("state")
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    return folder


@pytest.fixture
def quiet() -> Console:
    return Console(quiet=True)


Bench = tuple[Devices, World]
OpenBench = Callable[[RigConfig, Scene], AbstractContextManager[Bench]]


@pytest.fixture
def open_bench() -> OpenBench:
    """Open simulated devices together with the world that they share, so that a test can look behind them."""

    @contextmanager
    def opened(config: RigConfig, scene: Scene) -> Iterator[Bench]:
        with open_world(config, Simulation(scene)) as world:
            yield simulated_devices(config, world, Photographer(scene)), world

    return opened


def photo_bytes(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.glob("photos/**/*.jpg")}


@pytest.fixture(scope="session")
def read_photo_bytes() -> Callable[[Path], dict[str, bytes]]:
    return photo_bytes


@pytest.fixture(scope="session")
def captured(tmp_path_factory: pytest.TempPathFactory, config: RigConfig, scene: Scene) -> Path:
    """A whole session, captured once through the simulated devices; not to be written to."""
    folder = tmp_path_factory.mktemp("captured") / "session"
    with open_devices(config, simulation=Simulation(scene)) as devices:
        capture(config, folder, devices=devices, scene=scene, resume=False, console=Console(quiet=True))
    return folder


@pytest.fixture
def rig(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., tuple[int, str, str]]:
    """Return ``rig(arguments…)`` → exit code, what it printed, what it complained."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rig", *arguments])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = int(stop.code or 0)
        printed = capfd.readouterr()
        return code, printed.out, printed.err

    return run
