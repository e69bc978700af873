"""The one module that knows which devices are real.

Nothing here falls back to a simulated device: simulated devices come when they are asked for, real ones when they are
configured, and anything else is an error.
"""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.gphoto2_camera import Gphoto2Camera
from drivers.grbl_stage import GrblStage
from drivers.new_era_pump import NewEraPump
from drivers.protocols import Camera, Clock, Device, DeviceKind, Display, LevelSensor, Pump, Stage
from drivers.stripe_player import StripePlayer
from drivers.stripe_player.address import parse_address
from drivers.tank_board import TankBoard
from drivers.zaber_stage import ZaberStage
from recon.sessions.manifest import DeviceRecord
from rig.capturing.operators import ConsoleOperator, Operator
from rig.config import RigConfig
from rig.errors import ConfigError
from rig.rehearsing.emulation import emulate_rig
from rig.rehearsing.rehearsal import SimulatedOperator, Simulation, ledger_file, open_world
from rig.state_folder import state_folder
from rig.tank.ledger_book import LedgerBook, book_of, real_book
from sim_backend.camera import SimulatedCamera
from sim_backend.clock import RealClock
from sim_backend.display import SimulatedDisplay
from sim_backend.exposure import TakesPhotos
from sim_backend.photography import Photographer
from sim_backend.pump import SimulatedLevelSensor, SimulatedPump
from sim_backend.stage import SimulatedStage
from sim_backend.world import World

# How the simulated photo's time divides; the rest of a photo is its download.
EXPOSURE_FRACTION = 0.25
DISPLAY_LATENCY_S = 0.03
# How long a person may take to open the display's page.
PAGE_TIMEOUT_S = 300.0


@dataclass(frozen=True, slots=True)
class Devices:
    """Everything that a capture acts on. A rig for thin objects has no pump; few have a level sensor."""

    camera: Camera
    display: Display
    stage: Stage
    pump: Pump | None
    level_sensor: LevelSensor | None
    operator: Operator
    clock: Clock
    book: LedgerBook

    def records(self) -> dict[str, DeviceRecord]:
        """Return who answered, for the session's manifest."""
        named: dict[str, Device | None] = {
            "camera": self.camera,
            "display": self.display,
            "stage": self.stage,
            "pump": self.pump,
            "level_sensor": self.level_sensor,
        }
        records = {}
        for name, device in named.items():
            if device is not None:
                info = device.info()
                records[name] = DeviceRecord(
                    kind=info.kind, model=info.model, address=info.address, version=info.version
                )
        return records


@dataclass(frozen=True, slots=True)
class TankDevices:
    """What moving liquid by hand needs; :class:`Devices` has the same parts and more."""

    pump: Pump | None
    level_sensor: LevelSensor | None
    operator: Operator
    clock: Clock
    book: LedgerBook
    camera: Camera | None = None


@contextmanager
def open_devices(config: RigConfig, *, simulation: Simulation | None) -> Iterator[Devices]:
    """Open every device that ``config`` needs; on leaving, by any road, stage and pump stand still.

    Raises
    ------
    ConfigError
        When no simulation is asked for and a device is not configured.
    DeviceError
        When a device does not answer.
    """
    if simulation is None:
        with open_real_devices(config) as devices:
            yield devices
        return
    if simulation.wire:
        with open_emulated_devices(config, simulation) as devices:
            yield devices
        return
    with open_world(config, simulation) as world, ExitStack() as stack:
        book = book_of(config, ledger_file(simulation))
        devices = simulated_devices(config, world, Photographer(simulation.scene), book=book)
        for device in (devices.camera, devices.display, devices.stage, devices.pump, devices.level_sensor):
            if device is not None:
                stack.enter_context(device)
        yield devices


@contextmanager
def open_real_devices(config: RigConfig) -> Iterator[Devices]:
    """Open the devices that ``config`` names; what is not configured is refused in one sentence before any is touched."""
    wanted = {"camera", "display", "stage"} | ({"pump"} if config.tank and config.tank.has_pump else set())
    addresses = config.devices.model_dump()
    missing = sorted(name for name in wanted if not addresses[name])
    if missing:
        raise ConfigError(
            f"no {', '.join(missing)} configured: name driver and address in the section [devices] of the "
            "configuration, or rehearse with --sim"
        )
    display, operator, book = real_display(config), ConsoleOperator(), real_book(config)
    devices = real_devices(config, display=display, operator=operator, clock=RealClock(), book=book, kind="real")
    with ExitStack() as stack:
        stack.enter_context(devices.display)
        devices.display.screen()  # waits until somebody has opened the page
        _enter_hardware(devices, stack)
        yield devices


@contextmanager
def open_emulated_devices(config: RigConfig, simulation: Simulation) -> Iterator[Devices]:
    """Open the real drivers on emulators of the devices, which share one simulated world.

    Raises
    ------
    DeviceNotFoundError
        When Chromium, which plays the tablet, is not installed, or an emulator does not start.
    """
    exposure_s = EXPOSURE_FRACTION * config.timing.photo_s if simulation.real_time else 0.0
    download_s = config.timing.photo_s - exposure_s if simulation.real_time else 0.0
    times_s = {"exposure_s": exposure_s, "download_s": download_s}
    with ExitStack() as stack:
        world = stack.enter_context(open_world(config, simulation))
        optics = Photographer(simulation.scene)
        rig = stack.enter_context(emulate_rig(config, world, optics, camera_model=simulation.camera_model, **times_s))
        player = real_display(
            rig.config, kind="emulated", keep=Path(stack.enter_context(TemporaryDirectory(prefix="display-")))
        )
        operator, book = SimulatedOperator(world), book_of(config, ledger_file(simulation))
        devices = real_devices(
            rig.config, display=player, operator=operator, clock=world.clock, book=book, kind="emulated"
        )
        stack.enter_context(player)
        rig.tablet.open(player.url())
        player.screen()  # waits until the page has connected
        _enter_hardware(devices, stack)
        yield devices


def real_devices(
    config: RigConfig, *, display: Display, operator: Operator, clock: Clock, book: LedgerBook, kind: DeviceKind
) -> Devices:
    """Return the drivers that ``config`` names, not opened yet; ``kind`` is what the session records of them."""
    has_pump = config.tank is not None and config.tank.has_pump
    pump, level_sensor = real_pump(config, kind=kind) if has_pump else (None, None)
    return Devices(
        camera=real_camera(config, kind=kind),
        display=display,
        stage=real_stage(config, clock=clock, kind=kind),
        pump=pump,
        level_sensor=level_sensor,
        operator=operator,
        clock=clock,
        book=book,
    )


def _enter_hardware(devices: Devices, stack: ExitStack) -> None:
    """Open camera, stage and pump. What can flood or move is opened last and left first.

    A level sensor on the pump's board is opened with it.
    """
    for device in (devices.camera, devices.stage, devices.pump):
        if device is not None:
            stack.enter_context(device)


@contextmanager
def open_stage(config: RigConfig, *, simulation: Simulation | None) -> Iterator[Stage]:
    """Open the stage alone: nothing else need be configured or plugged in. Errors as for :func:`open_devices`."""
    if simulation is not None:
        with open_devices(config, simulation=simulation) as devices:
            yield devices.stage
        return
    with real_stage(config, clock=RealClock()) as stage:
        yield stage


def real_stage(config: RigConfig, *, clock: Clock, kind: DeviceKind = "real") -> Stage:
    """Return the stage that ``config`` names, not opened yet; raises ``ConfigError`` where no driver answers to it."""
    if not config.devices.stage:
        raise ConfigError(
            "no stage configured: name driver and address in the section [devices] of the configuration "
            '(stage = "grbl:/dev/ttyUSB0"), or rehearse with --sim'
        )
    driver, _, port = config.devices.stage.partition(":")
    travel_mm, velocity_mm_per_s = config.stage.travel_mm, config.stage.velocity_mm_per_s
    if driver == "grbl" and port:
        return GrblStage(port, travel_mm=travel_mm, velocity_mm_per_s=velocity_mm_per_s, clock=clock, kind=kind)
    if driver == "zaber" and port:
        if config.stage.microstep_mm is None:
            raise ConfigError(
                "stage.microstep_mm: this value is missing; a Zaber stage counts in microsteps, whose size is in its data "
                "sheet (X-LSM: 0.000047625)"
            )
        return ZaberStage(
            port,
            microstep_mm=config.stage.microstep_mm,
            travel_mm=travel_mm,
            velocity_mm_per_s=velocity_mm_per_s,
            clock=clock,
            kind=kind,
        )
    raise ConfigError(
        f"devices.stage: no driver answers to {config.devices.stage!r}; write grbl:PORT or zaber:PORT, or rehearse with --sim"
    )


@contextmanager
def open_tank(config: RigConfig, *, simulation: Simulation | None) -> Iterator[Devices | TankDevices]:
    """Open pump and level sensor alone: nothing else need be configured or plugged in.

    Errors as for :func:`open_devices`.
    """
    if simulation is not None:
        with open_devices(config, simulation=simulation) as devices:
            yield devices
        return
    pump, level_sensor = real_pump(config)
    with pump:
        yield TankDevices(
            pump,
            level_sensor,
            ConsoleOperator(),
            RealClock(),
            real_book(config),
        )


def real_pump(config: RigConfig, *, kind: DeviceKind = "real") -> tuple[Pump, LevelSensor | None]:
    """Return the pump that ``config`` names, and its level sensor if it has a calibrated one; neither is opened yet.

    Raises
    ------
    ConfigError
        Where no driver answers to the name, or a value that the driver needs is missing.
    """
    if config.tank is None or not config.devices.pump:
        raise ConfigError(
            "no pump configured: name driver and address in the section [devices] of the configuration "
            '(pump = "new_era:/dev/ttyUSB1"), or rehearse with --sim'
        )
    driver, _, port = config.devices.pump.partition(":")
    rate_ml_per_min, settings = config.tank.pump_rate_ml_per_min, config.pump
    if driver == "new_era" and port:
        if settings.diameter_mm is None:
            raise ConfigError(
                "pump.diameter_mm: this value is missing; a New Era pump chooses its units by the inside diameter of its "
                "tubing or syringe"
            )
        pump = NewEraPump(
            port,
            rate_ml_per_min=rate_ml_per_min,
            diameter_mm=settings.diameter_mm,
            mode=settings.mode,
            dead_man_s=settings.dead_man_s,
            baud=settings.baud or 19200,
            pump_number=settings.pump_number,
            kind=kind,
        )
        return pump, None
    if driver == "tank_board" and port:
        board = TankBoard(
            port,
            fill_ml_per_min=rate_ml_per_min,
            drain_ml_per_min=settings.drain_rate_ml_per_min or rate_ml_per_min,
            level_points=settings.level_points,
            baud=settings.baud or 115200,
            kind=kind,
        )
        return board, board if settings.level_points else None
    raise ConfigError(
        f"devices.pump: no driver answers to {config.devices.pump!r}; write new_era:PORT or tank_board:PORT, or rehearse "
        "with --sim"
    )


@contextmanager
def open_camera(config: RigConfig, *, simulation: Simulation | None) -> Iterator[Camera]:
    """Open the camera alone: nothing else need be configured or plugged in. Errors as for :func:`open_devices`."""
    if simulation is not None:
        with open_devices(config, simulation=simulation) as devices:
            yield devices.camera
        return
    with real_camera(config) as camera:
        yield camera


def real_camera(config: RigConfig, *, kind: DeviceKind = "real") -> Camera:
    """Return the camera that ``config`` names, not opened yet; raises ``ConfigError`` where no driver answers to it."""
    if not config.devices.camera:
        raise ConfigError(
            "no camera configured: name driver and address in the section [devices] of the configuration "
            '(camera = "gphoto2:usb:"), or rehearse with --sim'
        )
    driver, _, address = config.devices.camera.partition(":")
    if driver == "gphoto2" and address.startswith(("usb:", "ptpip:")):
        # Each photo proves its frame: then the next one may be shown before this one has arrived.
        overlap = config.frame_tag is not None and config.frame_tag.seen_px is not None
        return Gphoto2Camera(address, profile=config.devices.camera_profile, kind=kind, overlap=overlap)
    raise ConfigError(
        f"devices.camera: no driver answers to {config.devices.camera!r}; write gphoto2:usb: or gphoto2:ptpip:HOST, "
        "or rehearse with --sim"
    )


@contextmanager
def open_display(config: RigConfig, *, simulation: Simulation | None) -> Iterator[Display]:
    """Open the display alone: nothing else need be configured or plugged in. Errors as for :func:`open_devices`."""
    if simulation is not None:
        with open_devices(config, simulation=simulation) as devices:
            yield devices.display
        return
    with real_display(config) as display:
        yield display


def real_display(
    config: RigConfig,
    *,
    kind: DeviceKind = "real",
    keep: Path | None = None,
    page_timeout_s: float = PAGE_TIMEOUT_S,
) -> StripePlayer:
    """Return the display that ``config`` names, not opened yet; raises ``ConfigError`` where no driver answers to it.

    ``keep`` is the folder of the page's token and certificate; without it, the program's own. ``page_timeout_s`` is how
    long somebody may take to open the page.
    """
    if not config.devices.display:
        raise ConfigError(
            "no display configured: name driver and address in the section [devices] of the configuration "
            '(display = "browser:"), or rehearse with --sim'
        )
    driver, _, address = config.devices.display.partition(":")
    if driver == "browser":
        return StripePlayer(
            parse_address(address),
            primary=config.display.primary,
            state_folder=keep or state_folder() / "display",
            announce=lambda text: print(text, file=sys.stderr, flush=True),  # noqa: T201  (a question to the operator)
            page_timeout_s=page_timeout_s,
            kind=kind,
        )
    raise ConfigError(
        f"devices.display: no driver answers to {config.devices.display!r}; write browser: or browser:HOST:PORT, or "
        "rehearse with --sim"
    )


def simulated_devices(
    config: RigConfig, world: World, photographer: TakesPhotos, *, book: LedgerBook | None = None
) -> Devices:
    """Return simulated devices that share ``world``; nothing is opened yet. Without ``book`` nothing is known beforehand."""
    exposure_s = EXPOSURE_FRACTION * config.timing.photo_s
    tank = config.tank
    return Devices(
        camera=SimulatedCamera(
            world, photographer, exposure_s=exposure_s, download_s=config.timing.photo_s - exposure_s
        ),
        display=SimulatedDisplay(
            world, columns=config.display.columns, rows=config.display.rows, latency_s=DISPLAY_LATENCY_S
        ),
        stage=SimulatedStage(world, travel_mm=config.stage.travel_mm, velocity_mm_per_s=config.stage.velocity_mm_per_s),
        pump=SimulatedPump(world, rate_ml_per_min=tank.pump_rate_ml_per_min) if tank and tank.has_pump else None,
        level_sensor=SimulatedLevelSensor(world) if tank else None,
        operator=SimulatedOperator(world),
        clock=world.clock,
        book=book or book_of(config, None),
    )
