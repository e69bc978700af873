"""The ``rig`` command: plan, rehearse and run a capture."""

import logging
import sys
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from drivers.errors import DeviceError
from recon.command_group import CommandGroup, Interrupted
from recon.errors import ReconError
from recon.sessions.session import open_session
from rig import options
from rig.by_hand.camera_cli import app as camera_app
from rig.by_hand.display_cli import app as display_app
from rig.by_hand.emulate_cli import emulate
from rig.by_hand.pump_cli import app as pump_app
from rig.by_hand.stage_cli import app as stage_app
from rig.calibrating.calibrate_cli import app as calibrate_app
from rig.capturing.capture import capture as run_capture
from rig.capturing.known import Known, known_of
from rig.capturing.person import person_at_terminal
from rig.capturing.session_check import check_session
from rig.checking.doctor_cli import doctor
from rig.config import DEFAULT_FILE
from rig.devices import open_devices
from rig.errors import CaptureStopped, ConfigError, RigError
from rig.options import choose_rig, rig_of_session
from rig.planning.plan import plan_capture
from rig.planning.plan_table import print_plan
from rig.planning.steps import step_text
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session, simulate_truth
from sim_backend.scene import load_scene, scene_names

app = typer.Typer(
    name="rig",
    cls=CommandGroup,
    help="Photograph a transparent object: four sweeps of a stripe, two display places, dry and wet.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command()(doctor)
app.command()(emulate)
app.add_typer(stage_app, name="stage")
app.add_typer(pump_app, name="pump")
app.add_typer(camera_app, name="camera")
app.add_typer(calibrate_app, name="calibrate")
app.add_typer(display_app, name="display")
console = Console(soft_wrap=True, highlight=False)


@app.command()
def capture(
    session: Annotated[Path, typer.Option("--session", metavar="DIR", help="Folder of the session to write.")],
    sim: options.SimOption = False,
    sim_wire: options.SimWireOption = False,
    config: options.ConfigOption = None,
    scene: options.SceneOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a session that was interrupted.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print every step and touch nothing.")] = False,
    profile: options.ProfileOption = None,
    width_px: options.WidthOption = None,
    step_px: options.StepOption = None,
    order: options.OrderOption = None,
    size: options.SizeOption = None,
    display_columns: options.DisplayOption = None,
    seed: options.SeedOption = None,
    scan: options.ScanOption = False,
    live: options.LiveOption = False,
    auto_exposure: options.AutoExposureOption = False,
    code: options.CodeOption = None,
    watch: options.WatchOption = False,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", metavar="FILE", help="Measured poses and lens, in place of those configured."),
    ] = None,
    board: options.BoardOption = False,
    visual_rays: options.VisualRaysOption = None,
    state: options.StateOption = None,
    real_time: options.RealTimeOption = False,
    pause_after: Annotated[
        Literal["photo", "sweep", "set"] | None, typer.Option("--pause-after", help="Pause after each of these.")
    ] = None,
    checked: Annotated[
        bool,
        typer.Option("--checked", help="Somebody has looked at tank, pump and stage since the session latched."),
    ] = False,
) -> None:
    """Take the photos of the four sets.

    Ctrl-C pauses after the current photo and asks how to go on; a second Ctrl-C stops at once. Both leave the pump off and
    a session that --resume completes.
    """
    if checked and not resume:
        raise ConfigError("--checked answers a session that ended latched; add --resume, or leave it out")
    if sim and sim_wire:
        raise ConfigError("--sim and --sim-wire are two ways to rehearse; leave out one of them")
    sim = sim or sim_wire
    changes = SceneOptions(
        profile,
        width_px,
        step_px,
        order,
        size,
        display_columns,
        seed,
        scan,
        live,
        watch,
        auto_exposure,
        code,
        board,
        visual_rays,
    )
    if resume:
        if config is not None or scene is not None or calibration is not None or changes != SceneOptions():
            raise ConfigError(
                "--resume keeps the configuration that the session began with; leave out the other options"
            )
        rig = rig_of_session(session, sim)
    else:
        rig = choose_rig(sim, config, scene, changes).calibrated(calibration)
    if dry_run:
        known = Known()
        if resume:
            opened = open_session(session)
            known = known_of(opened, check_session(opened))
        for step in plan_capture(rig.config, done=known.done, ranges=known.ranges, judged=known.judged):
            console.print(step_text(step), markup=False)
        return
    simulation = rig.simulation(real_time=real_time, state_file=state, wire=sim_wire)
    with open_devices(rig.config, simulation=simulation) as devices:
        result = run_capture(
            rig.config,
            session,
            devices=devices,
            scene=rig.scene,
            resume=resume,
            console=console,
            person=person_at_terminal(console),
            pause_after=pause_after,
            checked=checked,
        )
    console.print(f"{session}: {result.photos_done} photos, {result.photos_taken} of them taken now", markup=False)


@app.command()
def simulate(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A name from `rig scenes`, or a TOML file.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the session to write.")],
    profile: options.ProfileOption = None,
    width_px: options.WidthOption = None,
    step_px: options.StepOption = None,
    order: options.OrderOption = None,
    size: options.SizeOption = None,
    display_columns: options.DisplayOption = None,
    seed: options.SeedOption = None,
    code: options.CodeOption = None,
    board: options.BoardOption = False,
    visual_rays: options.VisualRaysOption = None,
    workers: Annotated[int, typer.Option("--workers", min=1, help="Threads that compute photos.")] = 2,
    truth_only: Annotated[bool, typer.Option("--truth-only", help="Write manifest and truth, and no photo.")] = False,
) -> None:
    """Write a simulated session with its truth.

    The photos are those of `rig capture --sim`, computed without going through devices.
    """
    changes = SceneOptions(
        profile, width_px, step_px, order, size, display_columns, seed, code=code, board=board, visual_rays=visual_rays
    )
    opened = open_scene(scene, changes)
    if truth_only:
        simulate_truth(opened, config_of_scene(opened, changes), folder)
        console.print(f"{folder}: manifest and truth, no photos", markup=False)
        return
    count = simulate_session(opened, config_of_scene(opened, changes), folder, workers=workers, console=console)
    console.print(f"{folder}: {count} photos and their truth", markup=False)


@app.command()
def plan(
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG", help=f"The rig's configuration  [default: {DEFAULT_FILE}]")
    ] = None,
    sim: options.SimOption = False,
    scene: options.SceneOption = None,
    profile: options.ProfileOption = None,
    width_px: options.WidthOption = None,
    step_px: options.StepOption = None,
    order: options.OrderOption = None,
    size: options.SizeOption = None,
    display_columns: options.DisplayOption = None,
    scan: options.ScanOption = False,
    code: options.CodeOption = None,
    watch: options.WatchOption = False,
    board: options.BoardOption = False,
    predict: Annotated[
        str | None,
        typer.Option(
            "--predict",
            metavar="OBJECT",
            help="Say instead how sure points and normals of an object would be, and where the display should stand: "
            "'sphere RADIUS' in mm, or 'plane SIZE TILT' in mm and degrees.",
        ),
    ] = None,
    place_sd_px: Annotated[
        float,
        typer.Option(
            "--place-sd-px", min=1e-4, help="With --predict: expected sd of a place on the display, in its pixels."
        ),
    ] = 0.1,
    visual_rays: options.VisualRaysOption = None,
) -> None:
    """Say what a capture will do and cost.

    Every move, fill and sweep in order, then photos, time, liquid and disk space together.
    """
    changes = SceneOptions(
        profile,
        width_px,
        step_px,
        order,
        size,
        display_columns,
        scan=scan,
        watch=watch,
        code=code,
        board=board,
        visual_rays=visual_rays,
    )
    rig = choose_rig(sim or scene is not None, config, scene, changes)
    if predict is not None:
        # Loads what compiles loops, which would slow every other command.
        from rig.planning.predicted import alternatives, print_prediction

        print_prediction(alternatives(rig.config, predict, place_sd_px=place_sd_px), rig.config, console)
        return
    print_plan(plan_capture(rig.config), rig.config, console)


@app.command()
def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it.")] = DEFAULT_FILE,
) -> None:
    """Write a configuration to start from.

    Every value is explained in it; measure your rig and change the values.
    """
    if file.exists():
        raise ConfigError(f"{file}: exists already and is kept as it is; give another name, or remove it first")
    file.write_text((resources.files("rig") / "template.toml").read_text("utf-8"), encoding="utf-8")
    console.print(f"{file}: change the values to those of your rig, then look at `rig plan {file}`", markup=False)


@app.command()
def scenes() -> None:
    """List the scenes that can be simulated."""
    for name in scene_names():
        console.print(f"{name:24}{load_scene(name).note}", markup=False)


def main() -> None:
    """Run the command; every expected failure ends in one sentence and a non-zero exit code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        app(prog_name="rig")
    except CaptureStopped as stopped:
        _fail(str(stopped), code=130)
    except (RigError, ReconError, DeviceError) as error:
        _fail(str(error), code=1)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        _fail(f"{place}{error.strerror or error}", code=1)
    except (Interrupted, KeyboardInterrupt):
        _fail("interrupted", code=130)


def _fail(message: str, *, code: int) -> None:
    Console(stderr=True, soft_wrap=True, highlight=False).print(f"rig: {message}", markup=False)
    sys.exit(code)
