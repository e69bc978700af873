"""The liquid's part of a capture: fill and drain as planned, and know what the tank holds afterwards."""

from collections.abc import Callable

from drivers.protocols import FlowDirection
from recon.journal import JournalWriter
from rig.causes import part_of_rig
from rig.config import RigConfig
from rig.devices import Devices, TankDevices
from rig.errors import CaptureError, WrongLevelError
from rig.flow import check_pump_stands, check_volume, run_flow
from rig.plan import LEVEL_TOLERANCE
from rig.steps import DrainTank, FillTank, Request


class TankKeeper:
    """Moves the liquid. ``tank_ml`` is the ledger: what the tank holds, as far as we know."""

    def __init__(self, devices: Devices, journal: JournalWriter, config: RigConfig, *, tank_ml: float) -> None:
        self._devices = devices
        self._journal = journal
        self._config = config
        self.tank_ml = tank_ml

    def flow(self, step: FillTank | DrainTank, *, on_poll: Callable[[float], None]) -> None:
        """Fill or drain as planned; ``on_poll`` gets the millilitres so far, and what it raises ends the flow."""
        direction: FlowDirection = "fill" if isinstance(step, FillTank) else "drain"
        pump, tank = self._devices.pump, self._config.tank
        if pump is None or tank is None:
            raise CaptureError(f"the plan asks for a {direction}, but this rig has no pump; check section [tank]")
        check_pump_stands(self._devices, purpose=f"start a {direction}")
        check_volume(direction, volume_ml=step.volume_ml, tank_ml=self.tank_ml, tank=tank)
        before_ml = self.tank_ml
        self._journal.append(
            f"{direction}_started", volume_ml=step.volume_ml, to_ml=step.to_ml, max_run_s=step.max_run_s
        )
        try:
            with part_of_rig("pump"):
                run_flow(self._devices, direction, volume_ml=step.volume_ml, max_run_s=step.max_run_s, on_poll=on_poll)
        finally:
            with part_of_rig("pump"):
                moved_ml = pump.status().moved_ml
            self.tank_ml = self._level_ml(before_ml + (moved_ml if direction == "fill" else -moved_ml))
            self._journal.append(f"{direction}_stopped", moved_ml=moved_ml, tank_ml=self.tank_ml)
        if abs(self.tank_ml - step.to_ml) > LEVEL_TOLERANCE * tank.fill_ml:
            raise WrongLevelError(
                f"the {direction} ended with {self.tank_ml:.0f} ml in the tank instead of {step.to_ml:.0f} ml "
                f"(the pump counted {moved_ml:.0f} ml); look for a leak, an empty reservoir or a worn tube, then resume"
            )

    def moved_by_hand(self, request: Request) -> None:
        """Take down what a person did with the liquid."""
        tank = self._config.tank
        if tank is not None and request in ("fill_tank", "drain_tank"):
            self.tank_ml = self._level_ml(tank.fill_ml if request == "fill_tank" else 0.0)

    def _level_ml(self, ledger_ml: float) -> float:
        """Return what the tank holds: what the sensor says where there is one, else what the pump counted."""
        sensor = self._devices.level_sensor
        return ledger_ml if sensor is None else sensor.volume_ml()


def tank_ml_now(config: RigConfig, devices: Devices | TankDevices) -> float:
    """Return what the tank holds, from its sensor or from a person; never from what a journal expects."""
    if config.tank is None:
        return 0.0
    if devices.level_sensor is not None:
        return devices.level_sensor.volume_ml()
    return devices.operator.tank_ml(fill_ml=config.tank.fill_ml)
