"""The benches that each protocol is tested on: a device, and a world that says independently what really happened.

A driver with its emulator joins a suite by one more entry in ``STAGES``, ``PUMPS``, ``DISPLAYS`` or ``CAMERAS``.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import pytest
from browser_display import close_browser, close_pages, stripe_player_in_chromium

from drivers.gphoto2_camera import Gphoto2Camera
from drivers.grbl_stage import GrblStage
from drivers.new_era_pump import NewEraPump
from drivers.protocols import Camera, Display, Frame, Pump, Stage
from drivers.tank_board import TankBoard
from drivers.zaber_stage import ZaberStage
from rig.config import load_config
from rig.devices import real_camera, real_display, real_pump, real_stage
from rig.errors import RigError
from sim_backend.camera import SimulatedCamera
from sim_backend.clock import RealClock, SimulatedClock
from sim_backend.display import SimulatedDisplay
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.photography import Photographer
from sim_backend.ptpip.process import Model, emulate_camera
from sim_backend.ptpip.world_photos import WorldPhotos
from sim_backend.pump import SimulatedPump
from sim_backend.scene import load_scene
from sim_backend.stage import SimulatedStage
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import Emulator, PtyServer, TcpServer, WireServer
from sim_backend.world import TankSize, World, WorldState
from sim_backend.zaber_emulator import ZaberEmulator

COLUMNS, ROWS = 64, 64
TRAVEL_MM = (0.0, 100.0)
PUMP_ML_PER_MIN = 600.0
D = TypeVar("D")


@dataclass(frozen=True)
class Bench(Generic[D]):
    device: D
    world: Any  # a World, or what looks at the device in its place; None for a real device


def empty_world() -> World:
    dark = Frame(axis="x", levels=np.zeros(COLUMNS, np.uint8))
    state = WorldState(reservoir_ml=5000.0, stage_mm=37.0)
    return World(clock=SimulatedClock(), tank=TankSize(6000.0, 4000.0), dark_frame=dark, state=state)


@contextmanager
def simulated_stage() -> Iterator[Bench[Stage]]:
    world = empty_world()
    with SimulatedStage(world, travel_mm=TRAVEL_MM, velocity_mm_per_s=10.0) as stage:
        yield Bench(stage, world)


@contextmanager
def grbl_stage_on_a_terminal() -> Iterator[Bench[Stage]]:
    world = empty_world()
    with (
        PtyServer(GrblEmulator(world, travel_mm=TRAVEL_MM)) as wire,
        GrblStage(
            wire.address, travel_mm=TRAVEL_MM, velocity_mm_per_s=10.0, clock=world.clock, kind="emulated", banner_s=0.1
        ) as stage,
    ):
        yield Bench(stage, world)


@contextmanager
def zaber_stage(server: Callable[[Emulator], WireServer]) -> Iterator[Bench[Stage]]:
    world, microstep_mm = empty_world(), 0.000047625
    emulator = ZaberEmulator(world, travel_mm=TRAVEL_MM, microstep_mm=microstep_mm, velocity_mm_per_s=25.0)
    with (
        server(emulator) as wire,
        ZaberStage(
            wire.address,
            microstep_mm=microstep_mm,
            travel_mm=TRAVEL_MM,
            velocity_mm_per_s=10.0,
            clock=world.clock,
            kind="emulated",
        ) as stage,
    ):
        yield Bench(stage, world)


@contextmanager
def simulated_pump() -> Iterator[Bench[Pump]]:
    world = empty_world()
    with SimulatedPump(world, rate_ml_per_min=PUMP_ML_PER_MIN) as pump:
        yield Bench(pump, world)


@contextmanager
def new_era_pump() -> Iterator[Bench[Pump]]:
    world = empty_world()
    with (
        PtyServer(NewEraEmulator(world)) as wire,
        NewEraPump(wire.address, rate_ml_per_min=PUMP_ML_PER_MIN, diameter_mm=26.59, kind="emulated") as pump,
    ):
        yield Bench(pump, world)


@contextmanager
def new_era_pump_in_basic_mode() -> Iterator[Bench[Pump]]:
    world = empty_world()
    with (
        PtyServer(NewEraEmulator(world)) as wire,
        NewEraPump(
            wire.address, rate_ml_per_min=PUMP_ML_PER_MIN, diameter_mm=12.0, mode="basic", kind="emulated"
        ) as pump,
    ):
        yield Bench(pump, world)


@contextmanager
def tank_board() -> Iterator[Bench[Pump]]:
    world = empty_world()
    rate_ml_per_s = PUMP_ML_PER_MIN / 60
    board = TankBoardEmulator(world, fill_ml_per_s=rate_ml_per_s, drain_ml_per_s=rate_ml_per_s)
    with (
        PtyServer(board) as wire,
        TankBoard(
            wire.address, fill_ml_per_min=PUMP_ML_PER_MIN, drain_ml_per_min=PUMP_ML_PER_MIN, kind="emulated"
        ) as pump,
    ):
        yield Bench(pump, world)


@contextmanager
def simulated_display() -> Iterator[Bench[Display]]:
    world = empty_world()
    with SimulatedDisplay(world, columns=COLUMNS, rows=ROWS, latency_s=0.03) as display:
        yield Bench(display, world)


@contextmanager
def browser_display() -> Iterator[Bench[Display]]:
    with stripe_player_in_chromium(COLUMNS, ROWS) as (player, screen):
        yield Bench(player, screen)


@contextmanager
def simulated_camera() -> Iterator[Bench[Camera]]:
    world = empty_world()
    optics = Photographer(load_scene("semi_ellipsoid").resized(camera_columns=32, display_columns=COLUMNS))
    with SimulatedCamera(world, optics, exposure_s=0.5, download_s=1.5) as camera:
        yield Bench(camera, world)


@contextmanager
def libgphoto2_over_ptp_ip(*, model: Model = "generic", overlap: bool = False) -> Iterator[Bench[Camera]]:
    world = empty_world()
    optics = Photographer(load_scene("semi_ellipsoid").resized(camera_columns=32, display_columns=COLUMNS))
    with (
        emulate_camera(WorldPhotos(world, optics), model=model, exposure_s=0.05, download_s=0.6) as emulated,
        Gphoto2Camera(emulated.address, kind="emulated", overlap=overlap) as camera,
    ):
        yield Bench(camera, world)


Opener = Callable[[], AbstractContextManager[Bench[Any]]]
STAGES: dict[str, Opener] = {
    "simulated": simulated_stage,
    "GRBL on a terminal": grbl_stage_on_a_terminal,
    "Zaber on a terminal": partial(zaber_stage, PtyServer),
    "Zaber on TCP": partial(zaber_stage, TcpServer),
}
PUMPS: dict[str, Opener] = {
    "simulated": simulated_pump,
    "new era": new_era_pump,
    "new era in basic mode": new_era_pump_in_basic_mode,
    "tank board": tank_board,
}
DISPLAYS: dict[str, Opener] = {"simulated": simulated_display, "stripe player in Chromium": browser_display}
CAMERAS: dict[str, Opener] = {
    "simulated": simulated_camera,
    "libgphoto2 over PTP/IP": libgphoto2_over_ptp_ip,
    "libgphoto2 overlapping": partial(libgphoto2_over_ptp_ip, overlap=True),
    "libgphoto2 overlapping with an EOS": partial(libgphoto2_over_ptp_ip, model="canon-eos-40d", overlap=True),
}


BENCHES = {"open_stage": STAGES, "open_pump": PUMPS, "open_display": DISPLAYS, "open_camera": CAMERAS}


def pytest_configure(config: pytest.Config) -> None:
    text = "asks the device alone and not the simulated world, so that a real device can answer too (--hardware)"
    config.addinivalue_line("markers", f"without_world: {text}")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Ask each question of every bench, and with ``--hardware`` of the real devices too."""
    configuration = metafunc.config.getoption("--hardware")
    for fixture, benches in BENCHES.items():
        if fixture in metafunc.fixturenames:
            asked = [pytest.param(opener, id=name) for name, opener in benches.items()]
            if configuration is not None and fixture in (real := real_benches(configuration)):
                asked.append(pytest.param(real[fixture], id="hardware", marks=marks_on_hardware(metafunc)))
            metafunc.parametrize(fixture, asked, indirect=True)


def marks_on_hardware(metafunc: pytest.Metafunc) -> list[pytest.MarkDecorator]:
    """Skip, before the device is touched, whatever needs to know what really happened."""
    reason = "this test looks at the simulated world, and a real device has none"
    alone = metafunc.definition.get_closest_marker("without_world") is not None
    return [pytest.mark.hardware] if alone else [pytest.mark.hardware, pytest.mark.skip(reason=reason)]


@cache
def real_benches(configuration: str) -> dict[str, Opener]:
    """Return a bench for each device that the configuration names; nothing is opened yet."""
    try:
        config = load_config(Path(configuration))
    except (RigError, OSError) as error:
        raise pytest.UsageError(f"--hardware: {error}") from None
    openers: dict[str, tuple[str, Callable[[], Any]]] = {
        "open_stage": (config.devices.stage, lambda: real_stage(config, clock=RealClock())),
        "open_pump": (config.devices.pump, lambda: real_pump(config)[0]),
        "open_display": (config.devices.display, lambda: real_display(config)),
        "open_camera": (config.devices.camera, lambda: real_camera(config)),
    }
    real = {fixture: partial(real_bench, new) for fixture, (address, new) in openers.items() if address}
    if not real:
        raise pytest.UsageError(f"--hardware: {configuration} names no device in its section [devices]")
    return real


@contextmanager
def real_bench(new_device: Callable[[], Any]) -> Iterator[Bench[Any]]:
    with new_device() as device:
        yield Bench(device, None)


@pytest.fixture
def open_stage(request: pytest.FixtureRequest) -> Opener:
    return request.param


@pytest.fixture
def open_pump(request: pytest.FixtureRequest) -> Opener:
    return request.param


@pytest.fixture
def open_display(request: pytest.FixtureRequest) -> Iterator[Opener]:
    yield request.param
    close_pages()


@pytest.fixture
def open_camera(request: pytest.FixtureRequest) -> Opener:
    return request.param


@pytest.fixture(scope="session", autouse=True)
def the_browser_ends_with_the_tests() -> Iterator[None]:
    yield
    close_browser()
