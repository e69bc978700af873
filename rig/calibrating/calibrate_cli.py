"""``rig calibrate``: measure what the method stands on, step by step, with the rig's own devices."""

from pathlib import Path
from typing import Annotated

import typer

from recon.calibration.calibration_file import read_calibration
from recon.calibration.caliper import panel_check
from rig import options
from rig.calibrating import board_cli
from rig.calibrating.response_step import DRIFT_MIN, RESPONSE_PREPARATIONS, measure_response
from rig.calibrating.session_calibration import with_calibration_of
from rig.calibrating.terminal import FolderArgument, ready, say
from rig.capturing.session_manifest import manifest_of
from rig.options import choose_rig
from rig.rehearsing.scene_config import SceneOptions

app = typer.Typer(
    help="Calibrate: lens, display poses, response. `rig calibrate run DIR` leads through all of it; the others are its steps. "
    "Photos, numbers and report pages go into one folder.",
    no_args_is_help=True,
)
app.command()(board_cli.run)
app.command("board")(board_cli.board_file)
app.command()(board_cli.camera)
app.command()(board_cli.poses)
app.command()(board_cli.compute)


@app.command()
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The calibration.json to look at.")],
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    size: options.SizeOption = None,
    display_columns: options.DisplayOption = None,
) -> None:
    """Say whether a calibration fits the rig as it is configured now.

    A calibration of another display, camera or photo size is refused; age and changed settings are doubts.
    """
    read_calibration(file)  # what is wrong with the file itself is said first
    rig = choose_rig(sim, config, scene, SceneOptions(camera_columns=size, display_columns=display_columns))
    manifest = manifest_of(rig.config, devices={}, scene=rig.scene)
    _, doubts = with_calibration_of(manifest, str(file))
    for doubt in doubts:
        say(f"! {doubt}")
    say(f"{file}: fits this rig" + (f", with {len(doubts)} doubts" if doubts else ""))


@app.command()
def caliper(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The calibration.json to check.")],
    pixels: Annotated[float, typer.Option("--pixels", help="How many device pixels lie between the two places.")],
    length_mm: Annotated[float, typer.Option("--mm", help="Their distance as the caliper says.")],
    sd_mm: Annotated[float, typer.Option("--sd-mm", help="How well the caliper says it.")] = 0.05,
) -> None:
    """Check the scale with a known length: so many pixels of the display, measured with a caliper.

    Exit 1 where the two lengths disagree by more than three standard deviations.
    """
    calibration = read_calibration(file)
    check = panel_check(
        calibration.display,
        pixels,
        pitch_sd_share=calibration.quality.pitch_sd_share or 0.0,
        caliper_mm=length_mm,
        caliper_sd_mm=sd_mm,
    )
    say(check.sentence())
    if not check.agrees():
        raise typer.Exit(1)


@app.command()
def response(
    folder: FolderArgument,
    minutes: Annotated[
        float, typer.Option("--minutes", min=0.5, help="How long to watch the brightness for drift.")
    ] = DRIFT_MIN,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    size: options.SizeOption = None,
    display_columns: options.DisplayOption = None,
) -> None:
    """Measure how photos follow the display: levels, latency, flicker, drift, colour.

    Writes response.json and response.html into DIR.
    """
    changes = SceneOptions(camera_columns=size, display_columns=display_columns)
    rig = choose_rig(sim, config, scene, changes)
    ready(rig, *RESPONSE_PREPARATIONS)
    simulation = rig.simulation(real_time=False, state_file=None)
    measure_response(folder, rig.config, minutes=minutes, simulation=simulation, say=say)
