"""``rig pump``: the pump by hand, under the same rules for the tank as a capture."""

import math
from pathlib import Path
from typing import Annotated

import typer

from drivers.protocols import FlowDirection
from rig import options
from rig.capturing.stop_request import StopRequest
from rig.config import RigConfig, Tank
from rig.devices import Devices, TankDevices, open_tank
from rig.errors import ConfigError
from rig.options import choose_rig
from rig.rehearsing.scene_config import SceneOptions
from rig.tank.flow import check_level_after, learn_level, run_flow
from rig.tank.guard import Guard
from rig.tank.ledger import Destination, LevelLearnt, known_ml, level_text

app = typer.Typer(
    help="The pump by hand: fill, drain, prime, calibrate, stop, status, level. What tank and reservoir hold is remembered from "
    "command to command; with --sim, in and beside --state FILE.",
    no_args_is_help=True,
)
VolumeArgument = Annotated[
    float | None, typer.Argument(metavar="[ML]", help="How much to pump, in ml.", show_default=False)
]


def _tank(config: RigConfig) -> Tank:
    if config.tank is None or not config.tank.has_pump:
        raise ConfigError(f"{config.name}: this rig has no pump (section [tank] of the configuration)")
    return config.tank


def _print_levels(devices: Devices | TankDevices, tank: Tank) -> None:
    ledger = devices.book.ledger
    print(f"tank: {level_text(ledger.tank, limit_ml=tank.free_volume_ml)}")
    print(f"reservoir: {level_text(ledger.reservoir, limit_ml=tank.reservoir_can_hold_ml)}")


def _flow(
    config: RigConfig,
    devices: Devices | TankDevices,
    direction: FlowDirection,
    *,
    volume_ml: float | None = None,
    to_ml: float | None = None,
    into: Destination = "vessel",
) -> float:
    """Pump under the rules for the tank and return what the pump counted; Ctrl-C stops it."""
    tank = _tank(config)
    with StopRequest() as stop:
        learn_level(devices, config)
        guard = Guard(pump=devices.pump, book=devices.book, tank=tank)
        guard.check(direction)
        if volume_ml is None:
            volume_ml = ((to_ml or 0.0) - (known_ml(devices.book.ledger.tank) or 0.0)) * (
                1 if direction == "fill" else -1
            )
            if volume_ml <= 0:
                return 0.0
        guard.check(direction, volume_ml=volume_ml)
        return run_flow(
            devices,
            config,
            direction,
            volume_ml=volume_ml,
            to_ml=to_ml,
            into=into,
            on_poll=lambda _moved_ml: stop.check(),
        )


def _pump(
    direction: FlowDirection,
    volume_ml: float | None,
    to_ml: float | None,
    sim: bool,
    config: Path | None,
    scene: str | None,
    state: Path | None,
    real_time: bool,
) -> None:
    if (volume_ml is None) == (to_ml is None):
        raise ConfigError(f"a {direction} needs either how much to pump (ML) or what the tank shall hold (--to ML)")
    rig = choose_rig(sim, config, scene, SceneOptions())
    tank = _tank(rig.config)
    simulation = rig.simulation(real_time=real_time, state_file=state)
    with open_tank(rig.config, simulation=simulation) as devices:
        moved_ml = _flow(rig.config, devices, direction, volume_ml=volume_ml, to_ml=to_ml)
        print(f"pump: {moved_ml:.0f} ml counted")
        check_level_after(devices, rig.config, moved_ml=moved_ml)
        _print_levels(devices, tank)


@app.command(context_settings=options.NUMBERS_BELOW_ZERO)
def fill(
    volume_ml: VolumeArgument = None,
    to_ml: Annotated[
        float | None, typer.Option("--to", metavar="ML", min=0.0, help="Fill until the tank holds this much.")
    ] = None,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Pump liquid into the tank.

    With --to, the level sensor ends the fill where there is one; else the ledger says how much is missing. More than the
    tank may hold is refused before anything flows, and so is a fill while nobody knows what the tank holds. Ctrl-C stops
    the pump.
    """
    _pump("fill", volume_ml, to_ml, sim, config, scene, state, real_time)


@app.command(context_settings=options.NUMBERS_BELOW_ZERO)
def drain(
    volume_ml: VolumeArgument = None,
    to_ml: Annotated[
        float | None, typer.Option("--to", metavar="ML", min=0.0, help="Drain until the tank holds this much.")
    ] = None,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Pump liquid out of the tank, back into the reservoir, under the same rules as a fill."""
    _pump("drain", volume_ml, to_ml, sim, config, scene, state, real_time)


@app.command(context_settings=options.NUMBERS_BELOW_ZERO)
def prime(
    volume_ml: Annotated[float, typer.Argument(metavar="ML", help="The volume of the tubing, in ml.")] = 50.0,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Fill the tubing with liquid, so that the next fill counts liquid and not air.

    Call it again until no bubbles come.
    """
    _pump("fill", volume_ml, None, sim, config, scene, state, real_time)


@app.command()
def calibrate(
    duration_s: Annotated[float, typer.Argument(metavar="SECONDS", help="How long to pump.", min=1.0)] = 30.0,
    drain_side: Annotated[bool, typer.Option("--drain", help="Measure the other direction.")] = False,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Pump for a known time into a measuring cylinder and say what belongs into the configuration.

    Prime the tubing first, and hold the end of the hose into the cylinder.
    """
    rig = choose_rig(sim, config, scene, SceneOptions())
    rate_ml_per_min = _rate_ml_per_min(rig.config, drain_side)
    simulation = rig.simulation(real_time=real_time, state_file=state)
    with open_tank(rig.config, simulation=simulation) as devices:
        direction: FlowDirection = "drain" if drain_side else "fill"
        volume_ml = rate_ml_per_min / 60 * duration_s
        counted_ml = _flow(rig.config, devices, direction, volume_ml=volume_ml, into="cylinder")
        if devices.level_sensor is not None:
            devices.book.note(LevelLearnt("tank", devices.level_sensor.volume_ml(), "measured"))
    if counted_ml <= 0:
        raise ConfigError("the pump counted nothing, so there is nothing to measure; look at the pump and try again")
    measured_ml: float = typer.prompt("volume in the measuring cylinder, ml", type=float)
    if not 0 < measured_ml < math.inf:
        raise ConfigError(f"{measured_ml:g} ml is not a volume to calibrate with; measure again")
    print(
        f"pump: {counted_ml:.1f} ml counted, {measured_ml:.1f} ml measured; "
        + _advice(rig.config, drain_side, ratio=measured_ml / counted_ml)
    )


def _rate_ml_per_min(config: RigConfig, drain_side: bool) -> float:
    usual = _tank(config).pump_rate_ml_per_min
    return (config.pump.drain_rate_ml_per_min or usual) if drain_side else usual


def _advice(config: RigConfig, drain_side: bool, *, ratio: float) -> str:
    """Say which value makes the pump's count agree with the cylinder."""
    if config.devices.pump.startswith("new_era:") and config.pump.diameter_mm is not None:
        # The pump turns at the speed that its own diameter asks for; volume goes with the square of a diameter.
        return f"write diameter_mm = {config.pump.diameter_mm * math.sqrt(ratio):.2f} in section [pump]"
    rate_ml_per_min = _rate_ml_per_min(config, drain_side) * ratio
    if drain_side:
        return f"write drain_rate_ml_per_min = {rate_ml_per_min:.1f} in section [pump]"
    return f"write pump_rate_ml_per_min = {rate_ml_per_min:.1f} in section [tank]"


@app.command()
def stop(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
) -> None:
    """Stop the pump now; harmless when it stands."""
    rig = choose_rig(sim, config, scene, SceneOptions())
    tank = _tank(rig.config)
    with open_tank(rig.config, simulation=rig.simulation(real_time=False, state_file=state)) as devices:
        assert devices.pump is not None  # the tank has one
        devices.pump.stop()
        print("pump: stands still")
        learn_level(devices, rig.config)
        _print_levels(devices, tank)


@app.command()
def status(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
) -> None:
    """Say whether the pump runs, and what tank and reservoir hold, as far as anybody knows."""
    rig = choose_rig(sim, config, scene, SceneOptions())
    tank = _tank(rig.config)
    with open_tank(rig.config, simulation=rig.simulation(real_time=False, state_file=state)) as devices:
        assert devices.pump is not None  # the tank has one
        found = devices.pump.status()
        running = f"{found.direction}s, {found.moved_ml:.0f} ml so far" if found.running else "stands still"
        print(f"pump: {running}" + (f", alarm {found.alarm!r}" if found.alarm else ""))
        learn_level(devices, rig.config)
        _print_levels(devices, tank)


@app.command(context_settings=options.NUMBERS_BELOW_ZERO)
def level(
    tank_ml: Annotated[float, typer.Argument(metavar="ML", help="What the tank holds, in ml.")],
    reservoir_ml: Annotated[
        float | None, typer.Option("--reservoir", metavar="ML", min=0.0, help="What the reservoir holds, in ml.")
    ] = None,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
) -> None:
    """Say what the tank holds, after you have looked: the ledger then knows it again.

    Without --reservoir, what is not in the tank is taken to be in the reservoir.
    """
    rig = choose_rig(sim, config, scene, SceneOptions())
    tank = _tank(rig.config)
    for vessel, told_ml, limit_ml in (
        ("tank", tank_ml, tank.free_volume_ml),
        ("reservoir", reservoir_ml or 0.0, tank.reservoir_can_hold_ml),
    ):
        if not told_ml >= 0:
            raise ConfigError(f"{told_ml:g} ml in the {vessel} told, none holds less than nothing; measure again")
        if not told_ml <= limit_ml:
            raise ConfigError(f"{told_ml:g} ml in the {vessel} told, it can hold {limit_ml:g} ml; measure again")
    with open_tank(rig.config, simulation=rig.simulation(real_time=False, state_file=state)) as devices:
        devices.book.note(LevelLearnt("tank", tank_ml, "told"))
        if reservoir_ml is not None:
            devices.book.note(LevelLearnt("reservoir", reservoir_ml, "told"))
        _print_levels(devices, tank)
