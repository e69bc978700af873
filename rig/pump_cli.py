"""``rig pump``: the pump by hand, under the same rules for the tank as a capture."""

from pathlib import Path
from typing import Annotated

import typer

from drivers.protocols import FlowDirection
from rig import options
from rig.capture import tank_ml_now
from rig.config import RigConfig, Tank, longest_run_s
from rig.devices import Devices, open_devices
from rig.errors import ConfigError
from rig.flow import check_volume, run_flow
from rig.options import choose_rig
from rig.scene_config import SceneOptions
from rig.stop_request import StopRequest

app = typer.Typer(
    help="The pump by hand: fill, drain, stop, state. With --sim and --state FILE the tank keeps its liquid from command "
    "to command.",
    no_args_is_help=True,
)
VolumeArgument = Annotated[float, typer.Argument(metavar="ML", help="How much to pump, in ml.")]


def _tank(config: RigConfig) -> Tank:
    if config.tank is None or not config.tank.has_pump:
        raise ConfigError(f"{config.name}: this rig has no pump (section [tank] of the configuration)")
    return config.tank


def _level_text(devices: Devices, tank: Tank) -> str:
    if devices.level_sensor is None:
        return "no level sensor: look at the tank"
    return f"the tank holds {devices.level_sensor.volume_ml():.0f} ml of {tank.free_volume_ml:.0f} ml"


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
    with open_devices(rig.config, simulation=simulation) as devices, StopRequest() as stop:
        check_volume(direction, volume_ml=volume_ml, tank_ml=tank_ml_now(rig.config, devices), tank=tank)
        moved_ml = run_flow(
            devices,
            direction,
            volume_ml=volume_ml,
            max_run_s=longest_run_s(volume_ml, tank),
            on_poll=lambda _moved_ml: stop.check(),
        )
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
def stop(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
) -> None:
    """Stop the pump now; harmless when it stands."""
    rig = choose_rig(sim, config, scene, SceneOptions())
    tank = _tank(rig.config)
    with open_devices(rig.config, simulation=rig.simulation(real_time=False, state_file=state)) as devices:
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
    with open_devices(rig.config, simulation=rig.simulation(real_time=False, state_file=state)) as devices:
        assert devices.pump is not None  # the tank has one
        status = devices.pump.status()
        running = f"{status.direction}s, {status.moved_ml:.0f} ml so far" if status.running else "stands still"
        alarm = f", alarm {status.alarm!r}" if status.alarm else ""
        print(f"pump: {running}{alarm}; {_level_text(devices, tank)}")
