"""The liquid's part of a capture: fill and drain as planned, with the session's journal beside the ledger."""

from collections.abc import Callable

from drivers.protocols import FlowDirection
from recon.sessions.journal import JournalWriter
from rig.capturing.causes import part_of_rig
from rig.config import RigConfig
from rig.devices import Devices
from rig.errors import CaptureError, WrongLevelError
from rig.planning.plan import LEVEL_TOLERANCE
from rig.planning.steps import DrainTank, FillTank, Request
from rig.tank.flow import check_level_after, learn_level, run_flow
from rig.tank.guard import Guard
from rig.tank.ledger import LevelLearnt, Unknown, known_ml


def learn_tank_ml(devices: Devices, config: RigConfig, *, looked: bool = False) -> float:
    """Return what the tank holds: by sensor, by ledger, or by asking the operator where neither knows.

    Where a person pours, only a person knows. ``looked``: somebody stands beside the tank because something was in doubt;
    then they are also asked when sensor and ledger contradict each other.

    Raises
    ------
    WrongLevelError
        When the level sensor contradicts the ledger, or the person who has looked.
    """
    tank, book = config.tank, devices.book
    if tank is None:
        return 0.0
    try:
        learn_level(devices, config)
        in_doubt = isinstance(book.ledger.tank, Unknown) or not (tank.has_pump or devices.level_sensor)
    except WrongLevelError:
        if not looked:
            raise
        in_doubt = True
    if in_doubt:
        book.note(LevelLearnt("tank", devices.operator.tank_ml(fill_ml=tank.fill_ml), "told"))
        learn_level(devices, config)
    return known_ml(book.ledger.tank) or 0.0


class TankKeeper:
    """Moves the liquid. What the tank holds is in the ledger (``devices.book``)."""

    def __init__(self, devices: Devices, journal: JournalWriter, config: RigConfig, *, guard: Guard) -> None:
        self._devices = devices
        self._journal = journal
        self._config = config
        self._guard = guard

    @property
    def tank_ml(self) -> float | None:
        """What the tank holds, None while nobody knows."""
        return known_ml(self._devices.book.ledger.tank)

    def flow(self, step: FillTank | DrainTank, *, on_poll: Callable[[float], None]) -> None:
        """Fill or drain as planned; ``on_poll`` gets the millilitres so far, and what it raises ends the flow."""
        direction: FlowDirection = "fill" if isinstance(step, FillTank) else "drain"
        tank = self._config.tank
        if self._devices.pump is None or tank is None:
            raise CaptureError(f"the plan asks for a {direction}, but this rig has no pump; check section [tank]")
        self._guard.check(direction, volume_ml=step.volume_ml)
        before_ml = self.tank_ml or 0.0  # known, or the guard had refused
        self._journal.append(
            f"{direction}_started", volume_ml=step.volume_ml, to_ml=step.to_ml, max_run_s=step.max_run_s
        )
        try:
            with part_of_rig("pump"):
                moved_ml = run_flow(
                    self._devices, self._config, direction, volume_ml=step.volume_ml, to_ml=step.to_ml, on_poll=on_poll
                )
                check_level_after(self._devices, self._config, moved_ml=moved_ml)
        finally:
            # A flow of which nobody knows the end has none in the journal.
            if self.tank_ml is not None:
                self._journal.append(
                    f"{direction}_stopped", moved_ml=abs(self.tank_ml - before_ml), tank_ml=self.tank_ml
                )
        now_ml = self.tank_ml or 0.0
        if abs(now_ml - step.to_ml) > LEVEL_TOLERANCE * tank.fill_ml:
            raise WrongLevelError(
                f"the {direction} ended with {now_ml:.0f} ml in the tank instead of {step.to_ml:.0f} ml "
                f"(the pump counted {moved_ml:.0f} ml); look for a leak, an empty reservoir or a worn tube, then resume"
            )

    def check_level(self) -> None:
        """Ask the level sensor, where there is one, whether the liquid is still where it was left: hoses siphon."""
        with part_of_rig("pump"):
            learn_level(self._devices, self._config)

    def moved_by_hand(self, request: Request) -> None:
        """Take down what a person did with the liquid."""
        tank = self._config.tank
        if tank is not None and request in ("fill_tank", "drain_tank"):
            told_ml = tank.fill_ml if request == "fill_tank" else 0.0
            self._devices.book.note(LevelLearnt("tank", told_ml, "told"))
            learn_level(self._devices, self._config)
