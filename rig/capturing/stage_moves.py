"""The stage's part of a capture: home, move, and make sure before every photo that it stands where it was sent."""

from recon.sessions.journal import JournalWriter
from rig.capturing.causes import part_of_rig
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import StageMovedError
from rig.planning.steps import MoveStage, Position
from rig.tank.guard import Guard

# A stage may take twice its nominal time, plus what it takes to start.
STAGE_TIME_FACTOR = 2.0
STAGE_EXTRA_S = 10.0
# The stage's position is compared with the plan before each sweep: a tenth of a millimetre is a lost step, not noise.
POSITION_TOLERANCE_MM = 0.1


class StageMoves:
    """Moves the display. ``position`` is where it stands, None while that is not known."""

    def __init__(self, devices: Devices, journal: JournalWriter, config: RigConfig, *, guard: Guard) -> None:
        self._devices = devices
        self._journal = journal
        self._config = config
        self._guard = guard
        self._wanted_mm: float | None = None
        self.position: Position | None = None

    def home(self) -> None:
        """Find the stage's reference."""
        self._guard.check("home")
        self.forget()
        self._journal.append("homing_started")
        with part_of_rig("stage"), self._guard.moving():
            self._devices.stage.home(timeout_s=self._timeout_s())
            stage_mm = self._devices.stage.position_mm()
        self._journal.append("homing_finished", stage_mm=stage_mm)

    def move(self, step: MoveStage) -> None:
        """Carry the display to a position, and ask the stage whether it is there."""
        self._guard.check("move")
        self.forget()
        self._journal.append("move_started", position=step.position, to_mm=step.position_mm)
        with part_of_rig("stage"), self._guard.moving():
            self._devices.stage.move_to_mm(step.position_mm, timeout_s=self._timeout_s())
        self._wanted_mm = step.position_mm
        self._journal.append("move_finished", position=step.position, stage_mm=self.check_position_mm())
        self.position = step.position

    def forget(self) -> None:
        """Let the place of the display be unknown until the next move."""
        self._wanted_mm = None
        self.position = None

    def check_position_mm(self) -> float:
        """Return where the stage says it is, or refuse to go on when that is not where it was sent."""
        with part_of_rig("stage"):
            found_mm = self._devices.stage.position_mm()
        if self._wanted_mm is not None and not abs(found_mm - self._wanted_mm) <= POSITION_TOLERANCE_MM:
            raise StageMovedError(
                f"stage: {self._wanted_mm:.3f} mm asked, it stands at {found_mm:.3f} mm; "
                "somebody or something moved it; free it and resume the capture"
            )
        return found_mm

    def _timeout_s(self) -> float:
        stage = self._config.stage
        whole_travel_s = (stage.travel_mm[1] - stage.travel_mm[0]) / stage.velocity_mm_per_s
        return STAGE_TIME_FACTOR * whole_travel_s + STAGE_EXTRA_S
