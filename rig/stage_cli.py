"""``rig stage``: the stage by hand."""

from pathlib import Path
from typing import Annotated

import typer

from rig import options
from rig.devices import Devices, open_devices
from rig.options import Rig, choose_rig
from rig.scene_config import SceneOptions

app = typer.Typer(
    help="The stage by hand: home, move, where. With --sim and --state FILE it remembers from command to command.",
    no_args_is_help=True,
)
TIMEOUT_S = 300.0


def _open(sim: bool, config: Path | None, scene: str | None) -> Rig:
    return choose_rig(sim, config, scene, SceneOptions())


def _where(devices: Devices) -> str:
    low_mm, high_mm = devices.stage.travel_mm()
    homed = "" if devices.stage.is_homed() else ", but it was not homed, so this cannot be trusted"
    return f"stage: {devices.stage.position_mm():.3f} mm of {low_mm:g} to {high_mm:g} mm{homed}"


@app.command()
def home(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Find the reference switch. Look first: the stage drives along its whole travel."""
    rig = _open(sim, config, scene)
    with open_devices(rig.config, simulation=rig.simulation(real_time=real_time, state_file=state)) as devices:
        devices.stage.home(timeout_s=TIMEOUT_S)
        print(_where(devices))


@app.command()
def move(
    position_mm: Annotated[float, typer.Argument(metavar="MM", help="Where to go, in mm from the reference.")],
    home_first: Annotated[bool, typer.Option("--home", help="Home the stage first.")] = False,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
) -> None:
    """Drive to a position; anything outside the travel is refused before the stage moves."""
    rig = _open(sim, config, scene)
    with open_devices(rig.config, simulation=rig.simulation(real_time=real_time, state_file=state)) as devices:
        if home_first:
            devices.stage.home(timeout_s=TIMEOUT_S)
        devices.stage.move_to_mm(position_mm, timeout_s=TIMEOUT_S)
        print(_where(devices))


@app.command()
def where(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    state: options.StateOption = None,
) -> None:
    """Ask the stage where it stands."""
    rig = _open(sim, config, scene)
    with open_devices(rig.config, simulation=rig.simulation(real_time=False, state_file=state)) as devices:
        print(_where(devices))
