"""The options that several ``rig`` commands share, and what they mean together: the rig and, in rehearsal, its scene."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from recon.sessions.session import open_session
from rig.capturing.session_manifest import config_of_session, scene_of_session
from rig.config import DEFAULT_FILE, RigConfig, load_config
from rig.errors import ConfigError
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.scene import Scene

DEFAULT_SCENE = "semi_ellipsoid"

SimOption = Annotated[bool, typer.Option("--sim", help="Rehearse with simulated devices; nothing real is touched.")]
SimWireOption = Annotated[
    bool,
    typer.Option(
        "--sim-wire",
        help="Rehearse with the real drivers on emulated devices: a camera on PTP/IP, stage and pump on serial ports, the "
        "display's page in Chromium.",
    ),
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help=f"The rig's configuration  [default: {DEFAULT_FILE}]")
]
SceneOption = Annotated[
    str | None,
    typer.Option(
        "--scene",
        metavar="SCENE",
        help=f"What is simulated: a name from `rig scenes`, or a TOML file  [default: {DEFAULT_SCENE}]",
    ),
]
ProfileOption = Annotated[
    Literal["hard", "raised_cosine"] | None, typer.Option("--profile", help="Profile of the stripe.")
]
WidthOption = Annotated[
    float | None, typer.Option("--width-px", metavar="PX", help="Width of the stripe in device pixels.")
]
StepOption = Annotated[
    float | None, typer.Option("--step-px", metavar="PX", help="Step between two photos in device pixels.")
]
OrderOption = Annotated[
    Literal["one_fill", "paper"] | None,
    typer.Option("--order", help="one_fill: the tank is filled once. paper: filled, drained and filled again."),
]
SizeOption = Annotated[
    int | None, typer.Option("--size", metavar="COLUMNS", min=16, help="Columns of the simulated photo.")
]
DisplayOption = Annotated[
    int | None, typer.Option("--display-columns", metavar="COLUMNS", min=1, help="Columns of the simulated display.")
]
ScanOption = Annotated[
    bool,
    typer.Option(
        "--scan", help="Find the part of the display that is seen by a few photos a set, and sweep only that."
    ),
]
LiveOption = Annotated[
    bool,
    typer.Option(
        "--live", help="Decode each sweep while the next is photographed, and take a bad one again while it can be."
    ),
]
CodeOption = Annotated[
    Literal["gray_line", "phase_shift"] | None,
    typer.Option(
        "--code",
        help="Fewer photos than a sweep. gray_line: shifted lines and a Gray code. phase_shift: cosine fringes.",
    ),
]
AutoExposureOption = Annotated[
    bool, typer.Option("--auto-exposure", help="Choose the camera's exposure time before the first set.")
]
SeedOption = Annotated[int | None, typer.Option("--seed", min=0, help="Seed of the simulated noise.")]
WatchOption = Annotated[
    bool,
    typer.Option(
        "--watch", help="Watch that the simulated scene stays as it was: printed marks in it, reference photos."
    ),
]
BoardOption = Annotated[
    bool,
    typer.Option("--board", help="Photograph a calibration board on the display in each set: did the display slip?"),
]
VisualRaysOption = Annotated[
    Literal["photographed", "camera"] | None,
    typer.Option(
        "--visual-rays",
        help="Thin objects. photographed: two sets without the object. camera: its calibration gives them, and two sets suffice.",
    ),
]
StateOption = Annotated[
    Path | None,
    typer.Option(
        "--state",
        metavar="FILE",
        help="Keep the simulated tank and stage in this file between commands; else each command starts with an empty "
        "tank, a full reservoir and a stage that is not homed.",
    ),
]
RealTimeOption = Annotated[bool, typer.Option("--real-time", help="Let simulated devices take as long as real ones.")]


# For commands whose argument is a number: one below zero is a value, to be refused in words, and no unknown option.
NUMBERS_BELOW_ZERO = {"ignore_unknown_options": True}
# What an option of a rehearsal is called, and where a real rig has it.
OPTION_OF: dict[str, tuple[str, str]] = {
    "camera_columns": ("--size", "[camera]"),
    "display_columns": ("--display-columns", "[display]"),
    "scan": ("--scan", "[capture.scan]"),
    "live": ("--live", "[live]"),
    "watch": ("--watch", "[watch]"),
    "auto_exposure": ("--auto-exposure", "[capture.auto_exposure]"),
    "order": ("--order", "[capture]"),
    "code": ("--code", "[capture.code]"),
    "board": ("--board", "[capture.board]"),
    "seed": ("--seed", ""),
}


@dataclass(frozen=True, slots=True)
class Rig:
    """What a command works on: the configuration, and the simulated scene if this is a rehearsal."""

    config: RigConfig
    scene: Scene | None

    def calibrated(self, file: Path | None) -> "Rig":
        """Return the rig with a calibration to take over, if one is given."""
        if file is None:
            return self
        return replace(self, config=self.config.model_copy(update={"calibration": str(file)}))

    def simulation(self, *, real_time: bool, state_file: Path | None, wire: bool = False) -> Simulation | None:
        """Return how to simulate, or None for real devices; options of a rehearsal are refused for those."""
        if self.scene is None and (real_time or state_file is not None):
            raise ConfigError("--state and --real-time belong to simulated devices; add --sim, or leave them out")
        if self.scene is None:
            return None
        return Simulation(self.scene, real_time=real_time, state_file=state_file, wire=wire)


def choose_rig(sim: bool, config_file: Path | None, scene_name: str | None, options: SceneOptions) -> Rig:
    """Return the configured rig, or with ``sim`` the simulated one; mixtures are refused."""
    if not sim:
        if scene_name is not None or options != SceneOptions():
            raise ConfigError(_only_simulated(scene_name, options))
        return Rig(load_config(config_file or DEFAULT_FILE), None)
    if config_file is not None:
        raise ConfigError("--sim takes everything from its scene, so --config has no effect; leave out one of them")
    scene = open_scene(scene_name or DEFAULT_SCENE, options)
    return Rig(config_of_scene(scene, options), scene)


def _only_simulated(scene_name: str | None, options: SceneOptions) -> str:
    """Say which option belongs to simulated devices, and which section of the configuration says the same of a real rig."""
    if scene_name is not None:
        return f"--scene {scene_name} belongs to simulated devices; add --sim, or leave it out"
    given = next(field.name for field in fields(options) if getattr(options, field.name) != field.default)
    option, section = OPTION_OF.get(given, (f"--{given.replace('_', '-')}", "[capture.stripe]"))
    instead = f"set it in the section {section} of the configuration" if section else "leave it out"
    return f"{option} belongs to simulated devices; add --sim, or {instead}"


def rig_of_session(folder: Path, sim: bool) -> Rig:
    """Return the rig that a session was begun with; simulated and real photos never share a session."""
    session = open_session(folder)
    config, scene = config_of_session(session), scene_of_session(session)
    if sim and scene is None:
        raise ConfigError(f"{folder}: was begun with real devices; leave out --sim")
    if not sim and scene is not None:
        raise ConfigError(f"{folder}: was begun with simulated devices; add --sim")
    return Rig(config, scene)
