"""Moving liquid: the ledger first, then the pump, watched until it has ended, and what it came to.

The capture and the commands by hand both go through here, so that there is one set of rules for the tank.
"""

import math
from collections.abc import Callable
from contextlib import suppress

from drivers.errors import DeviceError, DeviceTimeoutError, OutOfVolumeError
from drivers.protocols import FlowDirection, Pump, PumpStatus
from rig.config import RigConfig, Tank, longest_run_s
from rig.devices import Devices, TankDevices
from rig.errors import CaptureError, CaptureStopped, TankAlarmError, WrongLevelError
from rig.planning.plan import LEVEL_TOLERANCE
from rig.tank.ledger import Destination, FlowBegun, FlowBroken, FlowEnded, Known, Ledger, LevelLearnt, level_text

# Slack beyond a pump's own time limit before it counts as stuck.
PUMP_EXTRA_S = 2.0
POLL_S = 0.25
SHORTEST_POLL_S = 0.02
# So long before the rim the level sensor ends any fill: longer than two looks near the end lie apart.
RIM_S = 0.1
# Canon bodies fall asleep while nothing is photographed; ten seconds is what libgphoto2 itself uses.
KEEP_AWAKE_EVERY_S = 10.0
# A pump that is stopped by the level sensor may count this much more than is missing: tubing wears by several per cent.
VOLUME_MARGIN = 1.1
# How far a sensor's reading may be from the ledger, as a part of a fill: an open tank evaporates overnight.
STANDING_TOLERANCE = 0.05
# After a flow, how far the count may be from the sensor, as a part of what was moved: as much as a pump's rate may drift.
COUNT_TOLERANCE = 0.1


def learn_level(devices: Devices | TankDevices, config: RigConfig) -> None:
    """Bring the ledger to what can be known without a person: a flow without an end is over, a sensor is asked.

    Raises
    ------
    WrongLevelError
        When the sensor contradicts the ledger: one of them is wrong, and only a person can say which.
    """
    book = devices.book
    if book.ledger.open_flow is not None:
        # Opening the pump has stopped it; how much it had moved until then is another question.
        book.note(FlowBroken(level_text(book.ledger.tank).removeprefix("unknown: ")))
    if devices.level_sensor is None or config.tank is None:
        return
    measured_ml = devices.level_sensor.volume_ml()
    _compare(devices, measured_ml, tolerance_ml=STANDING_TOLERANCE * config.tank.fill_ml)
    book.note(LevelLearnt("tank", measured_ml, "measured"))


def _compare(devices: Devices | TankDevices, measured_ml: float, *, tolerance_ml: float) -> None:
    believed = devices.book.ledger.tank
    if isinstance(believed, Known) and abs(believed.ml - measured_ml) > tolerance_ml:
        raise WrongLevelError(
            f"the level sensor says that the tank holds {measured_ml:.0f} ml, the ledger says {level_text(believed)}; look "
            "for a leak, an empty reservoir, a worn tube or a stuck sensor, then say what the tank holds with `rig pump level`"
        )


def run_flow(
    devices: Devices | TankDevices,
    config: RigConfig,
    direction: FlowDirection,
    *,
    volume_ml: float,
    to_ml: float | None = None,
    into: Destination = "vessel",
    on_poll: Callable[[float], None],
) -> float:
    """Pump, watch until the pump has stopped, and return what it counted in ml; the ledger knows it all.

    With ``to_ml`` and a level sensor the sensor ends the flow, and behind it stand two limits that do not ask the sensor:
    the volume, with a margin for a pump that has slowed down, and the time. ``on_poll`` gets the millilitres so far a few
    times a second; whatever it raises ends the flow. The pump is told to stop on every way out.
    """
    pump, tank, book = devices.pump, config.tank, devices.book
    if pump is None or tank is None:
        raise CaptureError(f"a {direction} was asked for, but this rig has no pump; check section [tank]")
    if to_ml is not None and devices.level_sensor is not None:
        volume_ml = min(VOLUME_MARGIN * volume_ml, max(volume_ml, _room_ml(book.ledger, direction, tank)))
    max_run_s = longest_run_s(volume_ml, tank)
    book.note(FlowBegun(direction, volume_ml, into))
    asked_to_stop: BaseException | None = None
    try:
        try:
            pump.start(direction, volume_ml=volume_ml, max_run_s=max_run_s)
            try:
                _watch(devices, pump, tank, direction, max_run_s=max_run_s, to_ml=to_ml, on_poll=on_poll)
            except (CaptureStopped, KeyboardInterrupt) as request:
                asked_to_stop = request  # by a person, of a pump that is well: its count holds
        finally:
            pump.stop()
        status = pump.status()
        _refuse_alarm(status)
    except OutOfVolumeError:  # before anything flowed
        book.note(FlowEnded(0.0))
        raise
    except BaseException as fault:
        book.note(FlowBroken(f"a {direction} of {volume_ml:.0f} ml ended with: {fault or type(fault).__name__}"))
        raise
    book.note(FlowEnded(status.moved_ml))
    if asked_to_stop is not None:
        raise asked_to_stop
    return status.moved_ml


def _room_ml(ledger: Ledger, direction: FlowDirection, tank: Tank) -> float:
    """Return how much more the vessel at the end of the flow can take."""
    level, limit_ml = (
        (ledger.tank, tank.free_volume_ml) if direction == "fill" else (ledger.reservoir, tank.reservoir_can_hold_ml)
    )
    return limit_ml - level.ml if isinstance(level, Known) else 0.0


def _watch(
    devices: Devices | TankDevices,
    pump: Pump,
    tank: Tank,
    direction: FlowDirection,
    *,
    max_run_s: float,
    to_ml: float | None,
    on_poll: Callable[[float], None],
) -> None:
    """Return when the pump has stopped by itself, or when the level sensor says that it is enough, or up to the rim."""
    clock = devices.clock
    deadline_s = clock.now_s() + max_run_s + PUMP_EXTRA_S
    awake_s = clock.now_s()
    while (status := pump.status()).running and not status.alarm:
        # Asked a moment ago: a computer that was asleep meanwhile must not take its own lateness for the pump's.
        if clock.now_s() > deadline_s:
            raise DeviceTimeoutError(f"pump: still running after {max_run_s:.0f} s; it was told to stop, look at it")
        on_poll(status.moved_ml)
        missing_ml = _missing_ml(devices, tank, direction, to_ml=to_ml)
        if missing_ml <= 0:
            return
        if devices.camera is not None and clock.now_s() - awake_s > KEEP_AWAKE_EVERY_S:
            awake_s = clock.now_s()
            with suppress(DeviceError):  # a camera that does not answer is told with the next photo
                devices.camera.keep_awake()
        clock.sleep_s(min(POLL_S, max(SHORTEST_POLL_S, missing_ml / tank.pump_rate_ml_per_min * 60)))
    _refuse_alarm(status)


def _missing_ml(devices: Devices | TankDevices, tank: Tank, direction: FlowDirection, *, to_ml: float | None) -> float:
    """Return how far the level sensor says that the flow is from its end; infinite where no sensor has a say."""
    sensor = devices.level_sensor
    if sensor is None or (direction == "drain" and to_ml is None):
        return math.inf
    if direction == "drain":
        return sensor.volume_ml() - (to_ml or 0.0)
    rim_ml = tank.free_volume_ml - RIM_S * tank.pump_rate_ml_per_min / 60
    return (rim_ml if to_ml is None else min(to_ml, rim_ml)) - sensor.volume_ml()


def _refuse_alarm(status: PumpStatus) -> None:
    if status.alarm:
        raise TankAlarmError(
            f"pump: alarm {status.alarm!r} after {status.moved_ml:.0f} ml; look at tank, hose and pump, then say what the tank "
            "holds (rig pump level ML)"
        )


def check_level_after(devices: Devices | TankDevices, config: RigConfig, *, moved_ml: float) -> None:
    """Compare count and sensor after a flow, where there is a sensor; the ledger then has what was measured.

    Raises
    ------
    WrongLevelError
        When they differ by more than a pump's rate may drift; the ledger keeps the count.
    """
    if devices.level_sensor is None or config.tank is None:
        return
    measured_ml = devices.level_sensor.volume_ml()
    tolerance_ml = LEVEL_TOLERANCE * config.tank.fill_ml + COUNT_TOLERANCE * moved_ml
    _compare(devices, measured_ml, tolerance_ml=tolerance_ml)
    devices.book.note(LevelLearnt("tank", measured_ml, "measured"))
