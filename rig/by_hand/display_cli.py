"""``rig display``: the display by hand."""

import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from recon.patterns.frame_tag_reading import find_tag
from recon.sessions.photos import decode_grey
from rig import options
from rig.capturing.frames import frame_of
from rig.devices import open_display
from rig.errors import ConfigError
from rig.options import Rig, choose_rig
from rig.planning.steps import TakePhoto
from rig.rehearsing.scene_config import SceneOptions

app = typer.Typer(
    help="The display by hand: show, screen, tag. It goes dark when a command ends.",
    no_args_is_help=True,
)
TIMEOUT_S = 30.0
# What a hand adds around the tag, so that it stays inside when display and liquid move it between the sets.
SEEN_MARGIN = 0.5


def _open(sim: bool, config: Path | None, scene: str | None) -> Rig:
    return choose_rig(sim, config, scene, SceneOptions())


@app.command()
def show(
    what: Annotated[Literal["white", "black", "stripe"], typer.Argument(help="What to show.")],
    number: Annotated[int, typer.Argument(metavar="[N]", min=0, help="Which stripe of the sweep, from 0.")] = 0,
    axis: Annotated[Literal["x", "y"], typer.Option("--axis", help="Along which axis the stripe's sweep goes.")] = "x",
    for_s: Annotated[
        float | None, typer.Option("--for", metavar="SECONDS", min=0, help="How long; else until the return key.")
    ] = None,
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
) -> None:
    """Show one frame, with its tag if the configuration has one, until the return key is pressed."""
    rig = _open(sim, config, scene)
    count = rig.config.pattern(axis).count
    if what == "stripe" and number >= count:
        raise ConfigError(f"stripe {number} asked, the sweep along {axis} has stripes 0 to {count - 1}")
    photo = TakePhoto("", axis if what == "stripe" else what, number, None, frame_id=number)
    with open_display(rig.config, simulation=rig.simulation(real_time=False, state_file=None)) as display:
        screen, panel = display.screen(), rig.config.display
        if (screen.columns, screen.rows) != (panel.columns, panel.rows):
            raise ConfigError(
                f"display: {panel.columns} × {panel.rows} device pixels configured, it has {screen.columns} × "
                f"{screen.rows}; correct section [display], or the display's full screen, zoom and rotation"
            )
        display.show(frame_of(photo, rig.config), frame_id=number, timeout_s=TIMEOUT_S)
        print(f"display: {f'stripe {number} along {axis}' if what == 'stripe' else what} is on the glass")
        if for_s is not None:
            time.sleep(for_s)
        elif not sim:
            print("press return to make it dark")
            sys.stdin.readline()


@app.command()
def screen(
    sim: options.SimOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
) -> None:
    """Say what the display says of itself."""
    rig = _open(sim, config, scene)
    with open_display(rig.config, simulation=rig.simulation(real_time=False, state_file=None)) as display:
        seen, panel = display.screen(), rig.config.display
        match = "as" if (seen.columns, seen.rows) == (panel.columns, panel.rows) else "NOT as"
        print(
            f"display: {seen.columns} × {seen.rows} device pixels at ratio {seen.pixel_ratio:g}, {match} configured "
            f"({panel.columns} × {panel.rows}); {'in sight' if seen.visible else 'hidden or asleep'}"
        )
        info = display.info()
        print(f"{info.kind}: {info.model} {info.address} {info.version}".rstrip())


@app.command()
def tag(
    photo: Annotated[Path, typer.Argument(metavar="PHOTO", help="A photo of the display with its frame tag.")],
) -> None:
    """Find the frame tag in a photo: its number, and where the configuration should say that it is seen."""
    try:
        grey = decode_grey(photo.read_bytes(), photo)
    except OSError as error:
        raise ConfigError(f"{photo}: cannot be read ({error.strerror})") from None
    found = find_tag(grey, full_scale=65535.0 if grey.dtype == "uint16" else 255.0)
    if found is None:
        raise ConfigError(
            f"{photo}: no frame tag was found; it must be in focus, seen directly, and 3 photo pixels a cell or more"
        )
    low, high = found.corners_px.min(axis=0), found.corners_px.max(axis=0)
    margin = SEEN_MARGIN * (high - low)
    last = [grey.shape[1] - 1, grey.shape[0] - 1]
    first, final = (low - margin).clip(0, last).round(), (high + margin).clip(0, last).round()
    print(f"frame {found.number}, contrast {found.contrast:.0f} of 255")
    print(f"seen_px = [{first[0]:.1f}, {first[1]:.1f}, {final[0]:.1f}, {final[1]:.1f}]")
