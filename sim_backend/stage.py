"""A simulated linear stage: it takes time, refuses to leave its travel, and must be homed."""

from types import TracebackType

from drivers.errors import DeviceTimeoutError, OutOfTravelError, UnknownPositionError
from drivers.protocols import DeviceInfo
from sim_backend.world import World, wait_until


class SimulatedStage:
    """Moves the display of ``world``. Implements :class:`drivers.protocols.Stage`."""

    def __init__(self, world: World, *, travel_mm: tuple[float, float], velocity_mm_per_s: float) -> None:
        self._world = world
        self._travel_mm = travel_mm
        self._velocity_mm_per_s = velocity_mm_per_s

    def info(self) -> DeviceInfo:
        """Say that this stage is simulated."""
        return DeviceInfo("simulated", "simulated linear stage")

    def travel_mm(self) -> tuple[float, float]:
        """Smallest and largest position."""
        return self._travel_mm

    def is_homed(self) -> bool:
        """Whether the position can be trusted."""
        return self._world.state().stage_homed

    def home(self, *, timeout_s: float) -> None:
        """Drive to the lower end of the travel, where the reference switch is."""
        self._world.set_homed(False)
        self._drive_to(self._travel_mm[0], timeout_s=timeout_s, what="homing")
        self._world.set_homed(True)

    def move_to_mm(self, position_mm: float, *, timeout_s: float) -> None:
        """Move and block until there. Raises ``OutOfTravelError`` or ``UnknownPositionError`` before any motion."""
        low_mm, high_mm = self._travel_mm
        if not low_mm <= position_mm <= high_mm:  # also refuses NaN
            raise OutOfTravelError(f"stage: {position_mm:g} mm asked, travel is {low_mm:g} to {high_mm:g} mm")
        if not self.is_homed():
            raise UnknownPositionError(
                f"stage: {position_mm:g} mm asked, but it was not homed; run `rig stage home` first"
            )
        self._drive_to(position_mm, timeout_s=timeout_s, what=f"the move to {position_mm:g} mm")

    def _drive_to(self, position_mm: float, *, timeout_s: float, what: str) -> None:
        self._world.start_motion(position_mm, velocity_mm_per_s=self._velocity_mm_per_s)
        try:
            arrived = wait_until(self._world.clock, lambda: not self._world.is_moving(), timeout_s=timeout_s)
        finally:
            self._world.stop_motion()
        if not arrived:
            raise DeviceTimeoutError(
                f"stage: {what} was not over after {timeout_s:g} s (it stands at {self.position_mm():.3f} mm); "
                "allow more time or check the stage"
            )

    def position_mm(self) -> float:
        """Where the stage is now."""
        return self._world.stage_mm()

    def stop(self) -> None:
        """Stop now; harmless when it stands."""
        self._world.stop_motion()

    def __enter__(self) -> "SimulatedStage":
        self.stop()  # it may still move for a program that was killed
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
