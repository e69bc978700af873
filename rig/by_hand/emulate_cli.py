"""``rig emulate``: emulated devices on real ports of this machine, for any program that speaks to such devices."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Annotated, Literal, assert_never

import numpy as np
import typer

from drivers.protocols import Frame
from rig import options
from rig.capturing.stop_request import StopRequest
from rig.config import RigConfig, StageTravel, Tank
from rig.devices import EXPOSURE_FRACTION
from rig.errors import CaptureStopped, ConfigError, RigError
from rig.options import DEFAULT_SCENE
from rig.rehearsing.emulation import PUMP_DIAMETER_MM
from rig.rehearsing.rehearsal import fresh_state, new_world
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.clock import FastClock
from sim_backend.grbl_emulator import GrblEmulator
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.photography import Photographer
from sim_backend.ptpip.process import Model, emulate_camera
from sim_backend.ptpip.world_photos import WorldPhotos
from sim_backend.scene import Scene
from sim_backend.tank_board_emulator import TankBoardEmulator
from sim_backend.wire import Emulator, PtyServer, Rfc2217Server, TcpServer, WireServer
from sim_backend.world import World
from sim_backend.zaber_emulator import ZaberEmulator

StageKind = Literal["grbl", "zaber", "none"]
PumpKind = Literal["new_era", "tank_board", "none"]
CameraKind = Literal["canon-eos-40d", "generic", "none"]
Wire = type[PtyServer] | type[TcpServer] | type[Rfc2217Server]

# An X-LSM stage: what one microstep moves, and how fast it is delivered.
MICROSTEP_MM = 0.000047625
ZABER_MM_PER_S = 25.0
POLL_S = 0.1
WHITE_LEVEL = 255


@dataclass(frozen=True, slots=True)
class Served:
    """One emulated device: its line of the section [devices], other settings that it needs, and how others reach it."""

    name: str
    address: str
    settings: dict[str, dict[str, str]]
    foreign: str
    wire: WireServer | None = None


def emulate(
    stage: Annotated[StageKind, typer.Option("--stage", help="Which stage.")] = "grbl",
    pump: Annotated[PumpKind, typer.Option("--pump", help="Which pump.")] = "new_era",
    camera: Annotated[CameraKind, typer.Option("--camera", help="Which camera, on PTP/IP.")] = "generic",
    scene: Annotated[
        str,
        typer.Option("--scene", metavar="SCENE", help="What is simulated: a name from `rig scenes`, or a TOML file."),
    ] = DEFAULT_SCENE,
    size: options.SizeOption = None,
    speed: Annotated[
        float, typer.Option("--speed", min=0.1, max=1000, help="How many times faster than in the room time passes.")
    ] = 1,
    pty: Annotated[bool, typer.Option("--pty", help="Serial devices on pseudo terminals (the default).")] = False,
    tcp: Annotated[bool, typer.Option("--tcp", help="Serial devices on TCP ports of 127.0.0.1.")] = False,
    rfc2217: Annotated[bool, typer.Option("--rfc2217", help="Serial devices on RFC 2217 ports of 127.0.0.1.")] = False,
) -> None:
    """Run emulated devices on real ports until Ctrl-C.

    They share one simulated world and are not real. What is printed is TOML for the configuration. There is no tablet:
    the camera photographs the scene behind a display that is white all over.
    """
    if pty + tcp + rfc2217 > 1:
        raise ConfigError("--pty, --tcp and --rfc2217 are three kinds of port; choose one of them")
    wire: Wire = TcpServer if tcp else Rfc2217Server if rfc2217 else PtyServer
    changes = SceneOptions(camera_columns=size)
    opened = open_scene(scene, changes)
    config = config_of_scene(opened, changes)
    clock = FastClock(speed)
    world = new_world(config, clock, fresh_state(config))
    with StopRequest() as stop, ExitStack() as stack:
        served = []
        if stage != "none":
            served.append(stack.enter_context(serve_stage(stage, world, config, wire)))
        if pump != "none":
            served.append(stack.enter_context(serve_pump(pump, world, config, wire, speed=speed)))
        if camera != "none":
            served.append(
                stack.enter_context(serve_camera(camera, world, opened, photo_s=config.timing.photo_s / speed))
            )
        if not served:
            raise ConfigError("no device is left to emulate; give at least one of --stage, --pump and --camera")
        print(announcement(served, scene=opened.name, speed=speed), flush=True)
        wait_for_the_end(served, stop)
    print("# The emulated devices are gone.", flush=True)


@contextmanager
def serve_stage(kind: Literal["grbl", "zaber"], world: World, config: RigConfig, wire: Wire) -> Iterator[Served]:
    """Serve a stage with the travel of ``config``."""
    low_mm, high_mm = config.stage.travel_mm
    names = ("position_0_mm", "position_1_mm", "velocity_mm_per_s")
    settings = _numbers(config.stage, names) | {"travel_mm": f"[{low_mm:.6g}, {high_mm:.6g}]"}
    emulator: Emulator
    match kind:
        case "grbl":
            emulator = GrblEmulator(world, travel_mm=config.stage.travel_mm)
        case "zaber":
            settings["microstep_mm"] = f"{MICROSTEP_MM:.9f}"
            emulator = ZaberEmulator(
                world,
                travel_mm=config.stage.travel_mm,
                microstep_mm=MICROSTEP_MM,
                velocity_mm_per_s=ZABER_MM_PER_S,
            )
        case _:
            assert_never(kind)
    with wire(emulator) as server:
        foreign = _terminal(server.address, baud=115200, end="LF")
        yield Served("stage", f"{kind}:{server.address}", {"stage": settings}, foreign, server)


@contextmanager
def serve_pump(
    kind: Literal["new_era", "tank_board"], world: World, config: RigConfig, wire: Wire, *, speed: float
) -> Iterator[Served]:
    """Serve a pump with the rate of ``config``; raises ``ConfigError`` for a scene without a tank.

    ``speed`` is how many times faster than the host's the world's time passes.
    """
    tank = config.tank
    if tank is None:
        raise ConfigError(f"scene {config.name} has no tank, so there is nothing to pump; add --pump none")
    volumes = _numbers(tank, ("free_volume_ml", "fill_ml", "reservoir_ml", "pump_rate_ml_per_min"))
    settings = {"tank": {**volumes, "has_pump": "true", "drain_at_end": "true"}}
    emulator: Emulator
    match kind:
        case "new_era":
            settings["pump"] = {"diameter_mm": f"{PUMP_DIAMETER_MM:g}"}
            emulator = NewEraEmulator(world, max_rate_ml_per_min=tank.pump_rate_ml_per_min, world_s_per_host_s=speed)
            baud, end = 19200, "CR"
        case "tank_board":
            rate_ml_per_s = tank.pump_rate_ml_per_min / 60
            emulator = TankBoardEmulator(
                world, fill_ml_per_s=rate_ml_per_s, drain_ml_per_s=rate_ml_per_s, world_s_per_host_s=speed
            )
            baud, end = 115200, "LF"
        case _:
            assert_never(kind)
    with wire(emulator) as server:
        foreign = _terminal(server.address, baud=baud, end=end)
        yield Served("pump", f"{kind}:{server.address}", settings, foreign, server)


@contextmanager
def serve_camera(kind: Model, world: World, scene: Scene, *, photo_s: float) -> Iterator[Served]:
    """Serve a camera that photographs ``scene`` as ``world`` has it, in front of a white display.

    ``photo_s`` is how long a photo takes with its download.
    """
    world.show(Frame(axis="x", levels=np.full(scene.display.columns, WHITE_LEVEL, np.uint8)), frame_id=None)
    photos = WorldPhotos(world, Photographer(scene))
    photos()  # tracing the scene takes seconds, which no host would wait at its first photo
    exposure_s = EXPOSURE_FRACTION * photo_s
    with emulate_camera(photos, model=kind, exposure_s=exposure_s, download_s=photo_s - exposure_s) as served:
        foreign = f'gphoto2 --port {served.address} --camera "PTP/IP Camera" --capture-image-and-download'
        yield Served("camera", f"gphoto2:{served.address}", {}, foreign)


def announcement(served: list[Served], *, scene: str, speed: float) -> str:
    """Return what the operator reads: TOML to copy into a configuration, and how other programs reach each device."""
    lines = [
        "# EMULATED DEVICES. NOTHING HERE IS REAL.",
        f"# They share one simulated world (scene {scene}, speed {speed:g}).",
        "# A driver cannot tell them from real ones and records them as real. A session made with them must say so:",
        '# write note = "emulated devices" into the section [object] of its configuration.',
    ]
    if any(device.name == "camera" for device in served):
        lines.append("# The camera sees a display that is white all over, whatever a rig shows on its own display.")
    lines += [
        "",
        "# For the configuration, in the place of its sections of the same names:",
        "",
        "[devices]",
        *(f'{device.name} = "{device.address}"' for device in served),
    ]
    for device in served:
        for section, values in device.settings.items():
            lines += ["", f"[{section}]", *(f"{name} = {value}" for name, value in values.items())]
    lines += ["", "# Other programs reach them too, one program at a time:"]
    lines += [f"# {device.name}: {device.foreign}" for device in served]
    return "\n".join([*lines, "# Ctrl-C ends them."])


def wait_for_the_end(served: list[Served], stop: StopRequest) -> None:
    """Wait until somebody asks to stop; raises ``RigError`` when an emulator has failed meanwhile."""
    try:
        while True:
            stop.check()
            for device in served:
                if device.wire is not None and not device.wire.is_serving:
                    raise RigError(f"{device.name}: the emulator at {device.address} failed and no longer answers")
            time.sleep(POLL_S)
    except CaptureStopped:
        return


def _numbers(part: StageTravel | Tank, names: tuple[str, ...]) -> dict[str, str]:
    return {name: f"{getattr(part, name):.6g}" for name in names}


def _terminal(address: str, *, baud: int, end: str) -> str:
    return f"python -m serial.tools.miniterm --eol {end} {address} {baud}"
