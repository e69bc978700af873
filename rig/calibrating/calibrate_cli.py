"""``rig calibrate``: measure what the method stands on, step by step, with the rig's own devices."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from recon.calibration.response_record import RESPONSE_NAME, write_response
from recon.report.response_page import RESPONSE_PAGE_NAME, response_verdict, write_response_page
from rig import options
from rig.calibrating.calibration_devices import open_camera_and_display
from rig.calibrating.calibration_folder import CalibrationFolder
from rig.calibrating.response_capture import ResponseCapture
from rig.calibrating.session_calibration import with_calibration_of
from rig.capturing.session_manifest import manifest_of
from rig.options import Rig, choose_rig
from rig.rehearsing.scene_config import SceneOptions

app = typer.Typer(
    help="Calibrate: measure the display's response, and check a calibration. Photos, numbers and a report page go into one "
    "folder.",
    no_args_is_help=True,
)
console = Console(soft_wrap=True, highlight=False)
FolderArgument = Annotated[
    Path, typer.Argument(metavar="DIR", help="Folder of the calibration; photos are kept in it.")
]


def say(text: str) -> None:
    """Tell the operator one thing, in one line."""
    console.print(text, markup=False)


def ready(rig: Rig, *steps: str) -> None:
    """Say what to prepare, and wait for the return key where somebody is there to press it."""
    for step in steps:
        say(f"· {step}")
    if rig.scene is None and sys.stdin is not None and sys.stdin.isatty():
        say("Press return when it is so.")
        sys.stdin.readline()


@app.command()
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The calibration.json to look at.")],
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
) -> None:
    """Say whether a calibration fits the rig as it is configured now.

    A calibration of another display, camera or photo size is refused; age and changed settings are doubts.
    """
    rig = choose_rig(sim, config, scene, SceneOptions())
    manifest = manifest_of(rig.config, devices={}, scene=rig.scene)
    _, doubts = with_calibration_of(manifest, str(file))
    for doubt in doubts:
        say(f"! {doubt}")
    say(f"{file}: fits this rig" + (f", with {len(doubts)} doubts" if doubts else ""))


@app.command()
def response(
    folder: FolderArgument,
    minutes: Annotated[
        float, typer.Option("--minutes", min=0.5, help="How long to watch the brightness for drift.")
    ] = 5.0,
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
    ready(
        rig,
        "The display has been on, bright, for half an hour; automatic brightness is off.",
        "The camera is set as for a capture and sees the display; the room is as dark as it will be.",
        "Nothing moves until this is done; liquid and object may stay as they are.",
    )
    simulation = rig.simulation(real_time=False, state_file=None)
    with (
        open_camera_and_display(rig.config, simulation=simulation) as devices,
        CalibrationFolder(folder, "response") as kept,
    ):
        found = ResponseCapture(devices, rig.config, kept, say).run(minutes=minutes)
    write_response(folder / RESPONSE_NAME, found)
    write_response_page(folder / RESPONSE_PAGE_NAME, found)
    verdict = response_verdict(found)
    say(f"{verdict.grade.upper()}: {verdict.next_action}")
    say(f"{folder / RESPONSE_PAGE_NAME}: the report; {len(found.photos)} photos are kept beside it")
