"""A simulated pump that ends its own flow, and a simulated level sensor in the tank."""

import math
from types import TracebackType

from drivers.errors import DeviceBusyError, OutOfVolumeError
from drivers.protocols import DeviceInfo, FlowDirection, PumpStatus
from sim_backend.world import World


class SimulatedPump:
    """Moves the liquid of ``world``. Implements :class:`drivers.protocols.Pump`.

    The volume and the longest run time end the flow on the world's clock, whether or not anybody still asks: the
    dead-man's switch that a real pump needs.
    """

    def __init__(self, world: World, *, rate_ml_per_min: float) -> None:
        self._world = world
        self._rate_ml_per_s = rate_ml_per_min / 60

    def info(self) -> DeviceInfo:
        """Say that this pump is simulated."""
        return DeviceInfo("simulated", "simulated pump")

    def start(self, direction: FlowDirection, *, volume_ml: float, max_run_s: float) -> None:
        """Begin to move ``volume_ml``; refuses a volume or time that is not positive, and a second start."""
        if not 0 < volume_ml < math.inf:
            raise OutOfVolumeError(f"pump: {volume_ml:g} ml asked, a {direction} needs a volume above 0 ml")
        if not 0 < max_run_s < math.inf:
            raise OutOfVolumeError(f"pump: a longest run of {max_run_s:g} s asked, it must be above 0 s")
        running = self._world.flow_direction()
        if running is not None:
            raise DeviceBusyError(f"pump: {direction} asked while a {running} is running; stop it first")
        self._world.start_flow(direction, rate_ml_per_s=self._rate_ml_per_s, volume_ml=volume_ml, max_run_s=max_run_s)

    def status(self) -> PumpStatus:
        """Whether it turns, which way, and what it counts since its start."""
        direction = self._world.flow_direction()
        return PumpStatus(direction is not None, direction, self._world.moved_ml())

    def stop(self) -> None:
        """Stop now; harmless when it stands."""
        self._world.stop_flow()

    def __enter__(self) -> "SimulatedPump":
        self.stop()  # it may still run for a program that was killed
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


class SimulatedLevelSensor:
    """Knows how much is in the tank of ``world``. Implements :class:`drivers.protocols.LevelSensor`."""

    def __init__(self, world: World) -> None:
        self._world = world

    def info(self) -> DeviceInfo:
        """Say that this sensor is simulated."""
        return DeviceInfo("simulated", "simulated level sensor")

    def volume_ml(self) -> float:
        """What the tank holds now."""
        return self._world.state().tank_ml

    def __enter__(self) -> "SimulatedLevelSensor":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None
