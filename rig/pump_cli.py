"""``rig pump``: the pump by hand, under the same rules for the tank as a capture."""

import math
from pathlib import Path
from typing import Annotated

import typer

from drivers.protocols import FlowDirection
from rig import options
from rig.config import RigConfig, Tank, longest_run_s
from rig.devices import Devices, TankDevices, open_tank
from rig.errors import ConfigError
from rig.flow import check_volume, run_flow
from rig.options import choose_rig
from rig.scene_config import SceneOptions
from rig.stop_request import StopRequest
from rig.tank_keeper import tank_ml_now

app = typer.Typer(
    help="The pump by hand: fill, drain, prime, calibrate, stop, state. With --sim and --state FILE the tank keeps its "
    "liquid from command to command.",
    no_args_is_help=True,
)
VolumeArgument = Annotated[float, typer.Argument(metavar="ML", help="How much to pump, in ml.")]


def _tank(config: RigConfig) -> Tank:
    if config.tank is None or not config.tank.has_pump:
        raise ConfigError(f"{config.name}: this rig has no pump (section [tank] of the configuration)")
    return config.tank


def _level_text(devices: Devices | TankDevices, tank: Tank) -> str:
    if devices.level_sensor is None:
        return "no level sensor: look at the tank"
    return f"the tank holds {devices.level_sensor.volume_ml():.0f} ml of {tank.free_volume_ml:.0f} ml"


def _flow(config: RigConfig, devices: Devices | TankDevices, direction: FlowDirection, *, volume_ml: float) -> float:
    """Pump under the rules for the tank and return what the pump counted; Ctrl-C stops it."""
    tank = _tank(config)
    with StopRequest() as stop:
        check_volume(direction, volume_ml=volume_ml, tank_ml=tank_ml_now(config, devices), tank=tank)
        return run_flow(
            devices,
            direction,
            volume_ml=volume_ml,
            max_run_s=longest_run_s(volume_ml, tank),
            on_poll=lambda _moved_ml: stop.check(),
        )


def _pump(
    direction: FlowDirection,
    volume_ml: float,
    sim: bool,
    config: Path | None,
    scene: str | None,
    state: Path | None,
    real_time: bool,
) -> None:
    rig = choose_rig(sim, config, scene, SceneOptions())
    tank = _tank(rig.config)
    simulation = rig.simulation(real_time=real_time, state_file=state)
    with open_tank(rig.config, simulation=simulation) as devices:
        moved_ml = _flow(rig.config, devices, direction, volume_ml=volume_ml)
        print(f"pump: {moved_ml:.0f} ml counted; {_level_text(devices, tank)}")


@app.command()
def fill(
    volume_ml: VolumeArgument,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Pump liquid into the tank.

    More than the tank may hold is refused before anything flows. Ctrl-C stops the pump.
    """
    _pump("fill", volume_ml, sim, config, scene, state, real_time)


@app.command()
def drain(
    volume_ml: VolumeArgument,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Pump liquid out of the tank, back into the reservoir."""
    _pump("drain", volume_ml, sim, config, scene, state, real_time)


@app.command()
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
    _pump("fill", volume_ml, sim, config, scene, state, real_time)


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
        counted_ml = _flow(rig.config, devices, direction, volume_ml=rate_ml_per_min / 60 * duration_s)
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
        print(f"pump: stands still; {_level_text(devices, tank)}")


@app.command(name="state")
def show_state(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
) -> None:
    """Say whether the pump runs, and what the tank holds."""
    rig = choose_rig(sim, config, scene, SceneOptions())
    tank = _tank(rig.config)
    with open_tank(rig.config, simulation=rig.simulation(real_time=False, state_file=state)) as devices:
        assert devices.pump is not None  # the tank has one
        status = devices.pump.status()
        running = f"{status.direction}s, {status.moved_ml:.0f} ml so far" if status.running else "stands still"
        alarm = f", alarm {status.alarm!r}" if status.alarm else ""
        print(f"pump: {running}{alarm}; {_level_text(devices, tank)}")
