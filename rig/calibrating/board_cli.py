"""The commands of ``rig calibrate`` that photograph boards, compute from the photos, and lead through all of it."""

from pathlib import Path
from typing import Annotated, Literal

import cv2
import typer

from rig import options
from rig.calibrating.boards import PRINTED_SQUARE_PX, board_picture, printed_board
from rig.calibrating.calibration_steps import (
    leave_out,
    photograph_lens,
    photograph_poses,
    with_board,
    with_own_noise,
)
from rig.calibrating.guide import Guide
from rig.calibrating.kept_photos import CAMERA, DRY, WET
from rig.calibrating.pose_capture import PREPARATIONS, needs_tank
from rig.calibrating.terminal import FolderArgument, ready, say, yes
from rig.errors import ConfigError
from rig.options import Rig, choose_rig
from rig.rehearsing.rehearsal import Simulation
from rig.rehearsing.scene_config import SceneOptions

SCENE = "lab"
SceneOption = Annotated[
    str | None,
    typer.Option(
        "--scene",
        metavar="SCENE",
        help=f"What is simulated: a name from `rig scenes`, or a TOML file  [default: {SCENE}]",
    ),
]
BoardOption = Annotated[
    Literal["printed", "display"] | None,
    typer.Option("--board", help="For the lens: a printed board, or the display, taken off its stage."),
]
SquaresOption = Annotated[
    str | None, typer.Option("--squares", metavar="AxB", help="Squares of the printed board, across and down: 9x6.")
]
SquareOption = Annotated[
    float | None, typer.Option("--square-mm", metavar="MM", min=0.01, help="Side of a printed square, as measured.")
]
DictionaryOption = Annotated[
    str | None, typer.Option("--dictionary", metavar="NAME", help="Markers of the printed board: DICT_5X5_250.")
]
LeaveOutOption = Annotated[
    list[str] | None,
    typer.Option(
        "--leave-out", metavar="NAME", help="A photo that shall not count (0003); may be given several times."
    ),
]
FillOption = Annotated[
    bool,
    typer.Option("--fill", help="Let the pump fill the tank, and drain it afterwards if the rig is configured so."),
]


def camera(
    folder: FolderArgument,
    board: BoardOption = None,
    squares: SquaresOption = None,
    square_mm: SquareOption = None,
    dictionary: DictionaryOption = None,
    leave_out_names: LeaveOutOption = None,
    sim: options.SimOption = False,
    sim_wire: options.SimWireOption = False,
    config: options.ConfigOption = None,
    scene: SceneOption = None,
    size: options.SizeOption = None,
    display_columns: options.DisplayOption = None,
    seed: options.SeedOption = None,
) -> None:
    """Photograph a ChArUco board in many poses, for the lens.

    After each photo one line says what it showed, what is covered, how well the views agree, and which pose is missing. It ends
    when nothing is missing, or at the answer d. Photos of an earlier run in DIR count.
    """
    rig, simulation = _rig(
        sim, sim_wire, config, scene, SceneOptions(camera_columns=size, display_columns=display_columns, seed=seed)
    )
    chosen = with_board(rig.config, board=board, squares=_squares(squares), square_mm=square_mm, dictionary=dictionary)
    leave_out(folder, CAMERA, leave_out_names or [])
    found = photograph_lens(folder, chosen, simulation=simulation, say=say)
    for advice in found.advice():
        say(f"! {advice}")
    say(f"{len(found.views)} photos count: {found.text()}; next: `rig calibrate poses {folder}`")


def poses(
    folder: FolderArgument,
    wet: Annotated[bool, typer.Option("--wet", help="Under liquid, instead of dry.")] = False,
    fill: FillOption = False,
    sim: options.SimOption = False,
    sim_wire: options.SimWireOption = False,
    config: options.ConfigOption = None,
    scene: SceneOption = None,
    size: options.SizeOption = None,
    display_columns: options.DisplayOption = None,
    seed: options.SeedOption = None,
    state: options.StateOption = None,
) -> None:
    """Photograph the board that the display shows at both positions.

    First with the tank dry; then, with --wet, under liquid, which tells whether the display slips when the tank is filled.
    Photos of an earlier run in DIR count.
    """
    rig, simulation = _rig(
        sim,
        sim_wire,
        config,
        scene,
        SceneOptions(camera_columns=size, display_columns=display_columns, seed=seed),
        state=state,
    )
    if wet:
        needs_tank(rig.config)
    ready(rig, *PREPARATIONS, "The tank is filled, or the pump may fill it." if wet else "The tank is empty.")
    photograph_poses(folder, rig.config, wet=wet, fill=fill, simulation=simulation, say=say)
    say(f"{'wet' if wet else 'dry'} photos are kept in {folder}; next: `rig calibrate compute {folder}`")


def compute(
    folder: FolderArgument,
    leave_out_names: LeaveOutOption = None,
    leave_out_dry: Annotated[
        list[str] | None,
        typer.Option("--leave-out-dry", metavar="NAME", help="The same for a dry photo of the display."),
    ] = None,
    leave_out_wet: Annotated[
        list[str] | None, typer.Option("--leave-out-wet", metavar="NAME", help="The same for a wet one.")
    ] = None,
) -> None:
    """Compute calibration.json again from the photos that DIR keeps; no device is needed."""
    # Loads what compiles loops, which would slow every other command.
    from rig.calibrating.computation import compute_calibration

    for part, names in ((CAMERA, leave_out_names), (DRY, leave_out_dry), (WET, leave_out_wet)):
        leave_out(folder, part, names or [])
    compute_calibration(folder, say)


def board_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Picture to write: board.png.")],
    squares: SquaresOption = None,
    dictionary: DictionaryOption = None,
) -> None:
    """Write a board to print.

    Print it at any size, without scaling it differently across and down, on something flat; then measure its squares.
    """
    if file.exists():
        raise ConfigError(f"{file}: exists already and is kept as it is; give another name, or remove it first")
    any_rig = choose_rig(True, None, SCENE, SceneOptions()).config
    chosen = with_board(any_rig, squares=_squares(squares) or (9, 6), square_mm=1.0, dictionary=dictionary)
    board = printed_board(chosen)
    if not cv2.imwrite(str(file), board_picture(board, square_px=PRINTED_SQUARE_PX)):
        raise ConfigError(f"{file}: cannot be written; give the name of a .png file in a folder that exists")
    say(
        f"{file}: {board.squares_x} x {board.squares_y} squares of {board.dictionary}; print it, glue it to something flat, "
        "measure its squares over many of them, and give the side with --square-mm"
    )


def run(
    folder: FolderArgument,
    response: Annotated[
        bool | None,
        typer.Option("--response/--no-response", help="Measure the display's response too, without asking."),
    ] = None,
    wet: Annotated[
        bool | None, typer.Option("--wet/--no-wet", help="Photograph under liquid too, without asking.")
    ] = None,
    fill: FillOption = False,
    board: BoardOption = None,
    squares: SquaresOption = None,
    square_mm: SquareOption = None,
    dictionary: DictionaryOption = None,
    sim: options.SimOption = False,
    sim_wire: options.SimWireOption = False,
    config: options.ConfigOption = None,
    scene: SceneOption = None,
    size: options.SizeOption = None,
    display_columns: options.DisplayOption = None,
    seed: options.SeedOption = None,
    state: options.StateOption = None,
) -> None:
    """Lead through the whole calibration: response, lens, poses dry and wet, computation, check.

    What DIR already holds is kept and said; run the same again after any interruption.
    """
    rig, simulation = _rig(
        sim,
        sim_wire,
        config,
        scene,
        SceneOptions(camera_columns=size, display_columns=display_columns, seed=seed),
        state=state,
    )
    chosen = with_board(rig.config, board=board, squares=_squares(squares), square_mm=square_mm, dictionary=dictionary)
    simulated = simulation is not None
    Guide(
        folder,
        chosen,
        rig.scene,
        simulation,
        say,
        ready=lambda *steps: ready(rig, *steps),
        ask=yes,
        response=False if response is None and simulated else response,
        wet=True if wet is None and simulated else wet,
        fill=True if fill or simulated else None,
    ).run()


def _rig(
    sim: bool,
    sim_wire: bool,
    config: Path | None,
    scene: str | None,
    changes: SceneOptions,
    *,
    state: Path | None = None,
) -> tuple[Rig, Simulation | None]:
    if sim and sim_wire:
        raise ConfigError("--sim and --sim-wire are two ways to rehearse; leave out one of them")
    simulated = sim or sim_wire
    rig = choose_rig(simulated, config, (scene or SCENE) if simulated else scene, changes)
    return rig, with_own_noise(rig.simulation(real_time=False, state_file=state, wire=sim_wire))


def _squares(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    across, _, down = text.partition("x")
    if not (across.isdecimal() and down.isdecimal()):
        raise ConfigError(f"--squares {text!r} asked; write how many squares across and down, such as 9x6")
    return int(across), int(down)
