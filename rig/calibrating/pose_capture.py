"""Photos of the board that the display shows at its two positions, tank dry or filled; the rig's own stage moves it."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field

from drivers.protocols import Frame
from recon.calibration.detection import BoardView, detect_board
from recon.calibration.photo_faults import board_fault
from rig.calibrating.boards import shown_board
from rig.calibrating.calibration_devices import CameraAndDisplay
from rig.calibrating.calibration_folder import CalibrationFolder
from rig.calibrating.calibration_photos import CalibrationCamera
from rig.calibrating.camera_capture import seen_text
from rig.capturing.stage_moves import StageMoves
from rig.capturing.stop_request import StopRequest
from rig.config import RigConfig, Tank, longest_run_s
from rig.devices import Devices
from rig.errors import CaptureError
from rig.planning.plan import LEVEL_TOLERANCE
from rig.planning.steps import DrainTank, FillTank, MoveStage, Position
from rig.tank.guard import Guard
from rig.tank.tank_keeper import TankKeeper, learn_tank_ml

POSITIONS: tuple[Position, Position] = (0, 1)
# A photo in which the board is not found is taken so often before somebody must look.
ATTEMPTS = 2
# Fewer of the corners than this means squares too small to be read, or something before the display.
FEW_SHARE = 0.4
PREPARATIONS = (
    "Camera and display are in their places, and stay there from now on.",
    "The object is out of the tank, or leaves most of the display in sight.",
    "The stage is free to move over its whole travel.",
)


def needs_tank(config: RigConfig) -> Tank:
    """Return the rig's tank; raises ``CaptureError`` where it has none to photograph wet."""
    if config.tank is None:
        raise CaptureError("this rig has no tank (section [tank]), so there is nothing to photograph wet")
    return config.tank


@dataclass(slots=True)
class PoseCapture:
    """Takes the photos for the display's poses, under the same interlocks as a capture.

    ``fill``: the operator agrees that the pump fills the tank before the wet photos, and drains it after them where the rig
    is configured so. Without that the tank must hold what it should.
    """

    devices: Devices
    config: RigConfig
    folder: CalibrationFolder
    say: Callable[[str], None]
    fill: bool = False
    _camera: CalibrationCamera = field(init=False)
    _stage: StageMoves = field(init=False)
    _tank: TankKeeper = field(init=False)
    _guard: Guard = field(init=False)

    def run(self, *, wet: bool, done: dict[Position, int]) -> None:
        """Photograph the board at both positions; ``done`` says how many photos each has already.

        Raises
        ------
        CaptureError
            Where the tank does not hold what it should, or the board is not seen; what was taken is kept.
        """
        devices = self.devices
        self._camera = CalibrationCamera(
            CameraAndDisplay(devices.camera, devices.display, devices.clock), self.config, self.folder
        )
        self._guard = Guard(pump=devices.pump, book=devices.book, tank=self.config.tank)
        self._stage = StageMoves(devices, self.folder.journal, self.config, guard=self._guard)
        self._tank = TankKeeper(devices, self.folder.journal, self.config, guard=self._guard)
        with StopRequest() as stop:
            with stop.at_once():
                tank_ml = learn_tank_ml(devices, self.config)
            filled = self._make_wet(tank_ml, stop) if wet else self._be_dry(tank_ml)
            with stop.at_once():
                self._photograph_all(done)
            if filled and self.config.tank is not None and self.config.tank.drain_at_end:
                self._drain(stop)

    def _photograph_all(self, done: dict[Position, int]) -> None:
        self._camera.set(self.config.camera.settings if self.devices.camera.info().kind == "real" else {})
        self.folder.begin(
            rig=self.config.model_dump(mode="json"),
            devices={name: record.model_dump() for name, record in self.devices.records().items()},
            settings=self._camera.settings,
        )
        if not self.devices.stage.is_homed():
            self.say("homing the stage")
            self._stage.home()
        for position in POSITIONS:
            missing = range(done.get(position, 0), self.config.calibrate.photos)
            if not missing:
                self.say(f"position {position}: its {self.config.calibrate.photos} photos are there already")
                continue
            self._stage.move(MoveStage(position, self.config.stage.position_mm(position)))
            self._camera.wait(self.config.timing.still_after_move_s)
            for number in missing:
                self._photograph(position, number)

    def _photograph(self, position: Position, number: int) -> BoardView:
        """Show the board and photograph it until it is found; one in which it is not is kept and does not count."""
        shown = shown_board(self.config, number)
        for attempt in range(1, ATTEMPTS + 1):
            self._guard.check("photo")
            self._camera.show(Frame(image=shown.image))
            stage_mm = self._stage.check_position_mm()
            with self._guard.exposing():
                taken = self._camera.take(
                    f"shown board at position {position}",
                    after_s=self.config.timing.settle_s,
                    board=asdict(shown.board),
                    position=position,
                    stage_mm=stage_mm,
                )
            view = detect_board(taken.grey, shown.board, name=taken.name)
            fault = board_fault(taken.grey, shown.board, view)
            if fault is None:
                self.say(f"position {position}, {seen_text(view, shown.board)}")
                if len(view.corner) < FEW_SHARE * len(shown.board.corner_mm()):
                    self.say(
                        "! few of the corners were found: take fewer squares (squares_along), or remove what hides them"
                    )
                return view
            self.folder.leave_out([taken.name])
            if attempt == ATTEMPTS:
                raise CaptureError(
                    f"board at position {position}, photo {taken.name}: {fault}; then run the same again"
                )
            self.say(f"! position {position}, {taken.name}: {fault}; trying once more")
        raise AssertionError("the last attempt returns or raises")

    def _be_dry(self, tank_ml: float) -> bool:
        tank = self.config.tank
        if tank is not None and tank_ml > LEVEL_TOLERANCE * tank.fill_ml:
            raise CaptureError(
                f"the tank holds {tank_ml:.0f} ml, the dry photos need it empty; drain it (`rig pump drain`, or by hand and then "
                "`rig pump level 0`) and run the same again"
            )
        return False

    def _make_wet(self, tank_ml: float, stop: StopRequest) -> bool:
        """Bring the tank to its level by the configured means, and return whether the pump did."""
        tank = needs_tank(self.config)
        missing_ml = tank.fill_ml - tank_ml
        if abs(missing_ml) <= LEVEL_TOLERANCE * tank.fill_ml:
            return False
        if not tank.has_pump and missing_ml > 0:
            self._guard.check("hands")
            self.devices.operator.do("fill_tank", f"Fill the tank with {tank.fill_ml:.0f} ml of liquid.")
            self._tank.moved_by_hand("fill_tank")
        elif missing_ml < 0 or not self.fill:
            raise CaptureError(
                f"the tank holds {tank_ml:.0f} ml, the wet photos need {tank.fill_ml:.0f} ml; fill it (`rig pump fill --to "
                f"{tank.fill_ml:.0f}`), or let this command do so with --fill"
            )
        else:
            self.say(f"filling {missing_ml:.0f} ml")
            step = FillTank(missing_ml, tank.fill_ml, longest_run_s(missing_ml, tank))
            self._tank.flow(step, on_poll=lambda _: stop.check())
        self._camera.wait(self.config.timing.still_after_fill_s)
        return tank.has_pump

    def _drain(self, stop: StopRequest) -> None:
        tank, held_ml = self.config.tank, self._tank.tank_ml
        if tank is None or not held_ml:
            return
        self.say(f"draining {held_ml:.0f} ml")
        step = DrainTank(held_ml, 0.0, longest_run_s(held_ml, tank))
        self._tank.flow(step, on_poll=lambda _: stop.check())
