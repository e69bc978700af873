"""The steps of a geometric calibration, each of which goes on where it was interrupted: photos for the lens, for the poses."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal

from drivers.protocols import Frame
from recon.calibration.board import Board
from recon.calibration.errors import CalibrationError
from rig.calibrating.boards import COARSEST, SQUARE_PX, board_picture, printed_board, shown_board
from rig.calibrating.calibration_devices import CameraAndDisplay, open_camera_alone, open_camera_and_display
from rig.calibrating.calibration_folder import CalibrationFolder
from rig.calibrating.camera_capture import CameraCapture, LensSoFar, lens_so_far
from rig.calibrating.hands import ConsoleHands, Hands
from rig.calibrating.kept_photos import CAMERA, DRY, WET, begun_with, kept_photos, read_view
from rig.calibrating.pose_capture import PoseCapture
from rig.config import RigConfig
from rig.devices import Devices, open_devices
from rig.errors import CaptureStopped
from rig.planning.steps import Position
from rig.rehearsing.board_hand import SimulatedHand
from rig.rehearsing.rehearsal import SimulatedOperator, Simulation
from sim_backend.held_sheet import Print

Say = Callable[[str], None]


def with_board(
    config: RigConfig,
    *,
    board: Literal["printed", "display"] | None = None,
    squares: tuple[int, int] | None = None,
    square_mm: float | None = None,
    dictionary: str | None = None,
) -> RigConfig:
    """Return the configuration with what was said of the board on the command line."""
    said = {"board": board, "squares": squares, "square_mm": square_mm, "dictionary": dictionary}
    changes = {name: value for name, value in said.items() if value is not None}
    return config.model_copy(update={"calibrate": config.calibrate.model_copy(update=changes)})


def refuse_other_rig(folder: Path, config: RigConfig) -> None:
    """Raise ``CaptureError`` where the folder was begun with photos or a display of another size."""
    begun = begun_with(folder)
    if begun is not None:
        begun.refuse_other(config, folder)


def lens_of_kept(folder: Path, config: RigConfig) -> LensSoFar:
    """Return what the kept photos tell of the lens."""
    return lens_so_far([read_view(folder, photo, config) for photo in kept_photos(folder, CAMERA)], config)


def leave_out(folder: Path, part: str, names: Sequence[str]) -> None:
    """Let photos of a part count no more; a name that none has is a ``CalibrationError``."""
    if not names:
        return
    unknown = sorted(set(names) - {photo.name for photo in kept_photos(folder, part)})
    if unknown:
        raise CalibrationError(f"{folder}: no photo of {part} that counts is called {', '.join(unknown)}")
    with CalibrationFolder(folder, part, go_on=True) as kept:
        kept.leave_out(names)


def photograph_lens(folder: Path, config: RigConfig, *, simulation: Simulation | None, say: Say) -> LensSoFar:
    """Photograph a board in many poses until nothing is missing; photos of earlier runs count."""
    refuse_other_rig(folder, config)
    printed = config.calibrate.board == "printed"
    shown = None if printed else shown_board(config, COARSEST)  # a hand holds it farther away and aslant
    board = printed_board(config) if shown is None else shown.board
    so_far = lens_of_kept(folder, config)
    if so_far.views:
        say(f"{len(so_far.views)} photos are kept: {so_far.text()}")
    opened = open_camera_alone if printed else open_camera_and_display
    with (
        _stopped_in_words(folder),
        opened(config, simulation=simulation) as devices,
        CalibrationFolder(folder, CAMERA, go_on=True) as kept,
    ):
        hands = hands_at(devices, config, board)
        frame = None if shown is None else Frame(image=shown.image)
        return CameraCapture(devices, config, kept, hands, board, frame, say, list(so_far.views)).run()


def hands_at(devices: CameraAndDisplay, config: RigConfig, board: Board) -> Hands:
    """Return who holds the board: a person, or in a simulation its hand."""
    if not isinstance(devices.operator, SimulatedOperator):
        return ConsoleHands()
    panel = config.display
    size_mm = (panel.columns * panel.pitch_mm, panel.rows * panel.pitch_mm)
    sheet = None
    if config.calibrate.board == "printed":
        sheet = Print(board_picture(board), board.square_mm / SQUARE_PX)
        size_mm = (board.squares_x * board.square_mm, board.squares_y * board.square_mm)
    return SimulatedHand(devices.operator.world, config.camera, printed=sheet, size_mm=size_mm)


def photograph_poses(
    folder: Path, config: RigConfig, *, wet: bool, fill: bool, simulation: Simulation | None, say: Say
) -> None:
    """Photograph the board on the display at both positions; photos of earlier runs count."""
    refuse_other_rig(folder, config)
    part = WET if wet else DRY
    done = photos_at_positions(folder, part)
    if all(done.get(position, 0) >= config.calibrate.photos for position in (0, 1)):
        say(f"{'wet' if wet else 'dry'}: {config.calibrate.photos} photos at each position are there already")
        return
    with (
        _stopped_in_words(folder),
        open_devices(config, simulation=simulation) as devices,
        CalibrationFolder(folder, part, go_on=True) as kept,
        _object_out(devices),
    ):
        PoseCapture(devices, config, kept, say, fill).run(wet=wet, done=done)


@contextmanager
def _stopped_in_words(folder: Path) -> Iterator[None]:
    """Let Ctrl-C end in one sentence."""
    try:
        yield
    except KeyboardInterrupt:
        raise CaptureStopped(
            f"{folder}: stopped as asked; every photo so far is kept, and the same command goes on behind it"
        ) from None


@contextmanager
def _object_out(devices: Devices) -> Iterator[None]:
    """Let the simulated person take the object out meanwhile; a real one was told to."""
    if not isinstance(devices.operator, SimulatedOperator):
        yield
        return
    devices.operator.do("remove_object", "")
    try:
        yield
    finally:
        devices.operator.do("insert_object", "")


def photos_at_positions(folder: Path, part: str) -> dict[Position, int]:
    """Return how many photos that count each position has."""
    counts = Counter(photo.position for photo in kept_photos(folder, part))
    return {0: counts[0], 1: counts[1]}


def with_own_noise(simulation: Simulation | None) -> Simulation | None:
    """Return the simulation in which several photos of the same thing differ by their noise."""
    return None if simulation is None else replace(simulation, own_noise=True)
