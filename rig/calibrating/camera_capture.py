"""Photos of a board in many poses, for the lens; after each, a line on what it showed, what is covered and what is missing."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field

import cv2
import numpy as np

from drivers.errors import DeviceBusyError, DeviceProtocolError
from drivers.protocols import Frame
from recon.calibration.board import Board
from recon.calibration.coverage import corner_counts, covered_ninths
from recon.calibration.detection import BoardView, detect_board
from recon.calibration.errors import CalibrationError
from recon.calibration.intrinsics import LensEstimate, calibrate_lens
from recon.calibration.photo_faults import board_fault
from rig.calibrating.calibration_devices import CameraAndDisplay
from rig.calibrating.calibration_folder import CalibrationFolder
from rig.calibrating.calibration_photos import CalibrationCamera
from rig.calibrating.hands import Hands
from rig.config import RigConfig

# While the views are too few to tell what is missing.
FIRST_ADVICE = (
    "Hold the board straight before the camera, so that it fills most of the picture.",
    "Tilt it by about 30°, its top or bottom edge away from the camera.",
    "Tilt it the other way.",
    "Hold it into another corner of the picture.",
)
LAYOUTS = {
    "new": "layout new",
    "legacy": "layout legacy",
    "either": "both layouts alike",
    "none": "neither layout",
}


@dataclass(frozen=True, slots=True, eq=False)
class LensSoFar:
    """What the views of a board tell of the lens so far; ``estimate`` is None while they are too few."""

    views: tuple[BoardView, ...]
    counts: np.ndarray
    estimate: LensEstimate | None

    def advice(self) -> tuple[str, ...]:
        """Return what is missing, the most useful first; empty where the views suffice."""
        if self.estimate is None:
            return FIRST_ADVICE[min(len(self.views), len(FIRST_ADVICE) - 1) :]
        return self.estimate.advice

    def text(self) -> str:
        """Return coverage with its map, residual and outliers in one line."""
        marks = (("■" if ninth else "□" for ninth in row) for row in covered_ninths(self.counts))
        text = f"covered {100 * (self.counts > 0).mean():.0f} % [{' '.join(''.join(row) for row in marks)}]"
        if self.estimate is not None:
            text += f" · residual {self.estimate.rms_px:.2f} px over {len(self.estimate.names)} views"
            if self.estimate.outliers:
                text += f" · {', '.join(self.estimate.outliers)} disagree: --leave-out"
        return text


def lens_so_far(views: Sequence[BoardView], config: RigConfig) -> LensSoFar:
    """Return what the views tell of the lens, however few they are."""
    columns, rows = config.camera.columns, config.camera.rows
    estimate = None
    # The first few views may leave the lens open: then there is nothing to tell yet.
    with suppress(CalibrationError, np.linalg.LinAlgError, cv2.error):
        estimate = calibrate_lens(views, columns=columns, rows=rows)
    return LensSoFar(tuple(views), corner_counts(views, columns=columns, rows=rows), estimate)


def seen_text(view: BoardView, board: Board) -> str:
    """Say how much of a board a photo shows."""
    return f"{view.name}: {len(view.corner)} of {len(board.corner_mm())} corners, {LAYOUTS[view.layout]}"


@dataclass(slots=True)
class CameraCapture:
    """Takes the photos for the lens. ``frame`` is the board as the display shows it; None where it is printed.

    ``views`` holds those that count, of earlier runs too.
    """

    devices: CameraAndDisplay
    config: RigConfig
    folder: CalibrationFolder
    hands: Hands
    board: Board
    frame: Frame | None
    say: Callable[[str], None]
    views: list[BoardView] = field(default_factory=list)

    def run(self) -> LensSoFar:
        """Photograph until nothing is missing, or the one who holds the board says that it is enough."""
        camera = CalibrationCamera(self.devices, self.config, self.folder)
        camera.set(self.config.camera.settings if self.devices.camera.info().kind == "real" else {})
        self.folder.begin(
            rig=self.config.model_dump(mode="json"),
            devices={name: record.model_dump() for name, record in self.devices.records().items()},
            settings=camera.settings,
        )
        if self.frame is not None:
            camera.show(self.frame)
        found = lens_so_far(self.views, self.config)
        tried = len(self.views)
        try:
            while advice := found.advice():
                self.say(f"next: {advice[0]}")
                answer = self.hands.pose(tried, advice)
                if answer == "done":
                    break
                tried += answer == "photo"
                done = self._take_back() if answer == "back" else self._photograph(camera)
                if done is not None:
                    found = lens_so_far(self.views, self.config)
                    self.say(f"{done} · {found.text()}")
        finally:
            self.hands.away()
        if not found.advice():
            self.say("nothing is missing")
        return found

    def _take_back(self) -> str | None:
        if not self.views:
            self.say("! there is no photo to leave out")
            return None
        name = self.views.pop().name
        self.folder.leave_out([name])
        return f"{name}: left out"

    def _photograph(self, camera: CalibrationCamera) -> str | None:
        """Take one photo and return what it shows; of one that does not serve it is said why, it is kept and does not count."""
        held = "display" if self.frame is not None else "printed"
        try:
            taken = camera.take(
                f"{held} board",
                after_s=self.config.timing.settle_s,
                primary=None if self.frame is not None else "white",
                board=asdict(self.board),
            )
        except (DeviceBusyError, DeviceProtocolError) as error:
            self.say(f"! {error}; take it again")
            return None
        view = detect_board(taken.grey, self.board, name=taken.name)
        fault = board_fault(taken.grey, self.board, view)
        if fault is not None:
            self.folder.leave_out([taken.name])
            self.say(f"! {taken.name}: {fault}")
            return None
        self.views.append(view)
        return seen_text(view, self.board)
