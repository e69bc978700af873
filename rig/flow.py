"""Moving liquid safely: what is refused before the pump turns, and how a flow is watched until it has ended.

The capture and the commands by hand both go through here, so that there is one set of rules for the tank.
"""

from collections.abc import Callable

from drivers.errors import DeviceTimeoutError, OutOfVolumeError
from drivers.protocols import FlowDirection
from rig.causes import part_of_rig
from rig.config import Tank
from rig.devices import Devices, TankDevices
from rig.errors import CaptureError, TankAlarmError

# Slack beyond a pump's own time limit before it counts as stuck.
PUMP_EXTRA_S = 2.0
POLL_S = 0.25
# Canon bodies fall asleep while nothing is photographed; ten seconds is what libgphoto2 itself uses.
KEEP_AWAKE_EVERY_S = 10.0


def check_pump_stands(devices: Devices, *, purpose: str) -> None:
    """Refuse ``purpose`` while the pump runs, or while it says that something is wrong, such as a leak."""
    if devices.pump is None:
        return
    with part_of_rig("pump"):
        status = devices.pump.status()
    if status.running:
        raise CaptureError(f"the pump is running, so it is not safe to {purpose}; stop it and try again")
    if status.alarm:
        raise TankAlarmError(f"pump: {status.alarm}; it is not safe to {purpose}, look at tank and pump first")


def check_volume(direction: FlowDirection, *, volume_ml: float, tank_ml: float, tank: Tank) -> None:
    """Refuse a flow that would take the tank past its free volume, before anything is pumped."""
    if direction == "fill" and tank_ml + volume_ml > tank.free_volume_ml:
        raise OutOfVolumeError(
            f"pump: a fill of {volume_ml:.0f} ml asked, the tank holds {tank_ml:.0f} ml and may hold "
            f"{tank.free_volume_ml:.0f} ml; fill less, or drain the tank first"
        )


def run_flow(
    devices: Devices | TankDevices,
    direction: FlowDirection,
    *,
    volume_ml: float,
    max_run_s: float,
    on_poll: Callable[[float], None],
) -> float:
    """Pump, watch until the pump has stopped by itself, and return what it counted in ml.

    ``on_poll`` gets the millilitres so far a few times a second; whatever it raises ends the flow. The pump is told to
    stop on every way out.
    """
    pump = devices.pump
    if pump is None:
        raise CaptureError(f"a {direction} was asked for, but this rig has no pump; check section [tank]")
    clock = devices.clock
    try:
        pump.start(direction, volume_ml=volume_ml, max_run_s=max_run_s)
        deadline_s = clock.now_s() + max_run_s + PUMP_EXTRA_S
        awake_s = clock.now_s()
        while (status := pump.status()).running and not status.alarm:
            on_poll(status.moved_ml)
            if clock.now_s() > deadline_s:
                raise DeviceTimeoutError(
                    f"pump: still running after {max_run_s:.0f} s; it was told to stop, look at it"
                )
            if devices.camera is not None and clock.now_s() - awake_s > KEEP_AWAKE_EVERY_S:
                devices.camera.keep_awake()
                awake_s = clock.now_s()
            clock.sleep_s(POLL_S)
    finally:
        pump.stop()
    if status.alarm:
        raise TankAlarmError(f"pump: alarm {status.alarm!r} after {status.moved_ml:.0f} ml; look at the pump")
    return pump.status().moved_ml
