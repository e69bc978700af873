"""The doctor's checks of stage, pump and display: they open each device, ask it, and close it."""

import math
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import numpy as np

from drivers.protocols import Device, DeviceInfo, Display, Frame, LevelSensor, Pump, Stage
from drivers.stripe_player import StripePlayer
from rig.checking.doctor import Finding, Result
from rig.config import RigConfig
from rig.devices import real_display, real_pump, real_stage
from sim_backend.clock import RealClock

SHOW_S = 10.0
# A tablet in its low-power mode refreshes 30 times a second.
LOW_REFRESH_HZ = 45.0
# From the acknowledgement to the light: a panel draws one refresh late and needs about another to answer.
SETTLED_REFRESHES = 2
ASKED_LEVEL = "no level sensor: a capture that goes on asks you what the tank holds"


@runtime_checkable
class HasRehearsal(Protocol):
    """A pump that can prove its safety settings without pumping."""

    def rehearse(self) -> str:
        """Say what was proven."""
        ...


def answers(name: str, device: Device) -> Finding:
    """Say who answered."""
    info = device.info()
    return Finding(name, "pass", _who(info))


def _who(info: DeviceInfo) -> str:
    version = f", {info.version}" if info.version else ""
    return f"{info.model} answers at {info.address}{version}" + ("" if info.kind == "real" else f" ({info.kind})")


def check_stage(config: RigConfig) -> Iterator[Finding]:
    """Open the stage, compare its travel with the two positions, ask whether it is homed."""
    with real_stage(config, clock=RealClock()) as stage:
        yield answers("stage", stage)
        yield from _travel_and_reference(stage, config)


def _travel_and_reference(stage: Stage, config: RigConfig) -> Iterator[Finding]:
    low_mm, high_mm = stage.travel_mm()
    places_mm = (config.stage.position_0_mm, config.stage.position_1_mm)
    covered = all(low_mm <= place_mm <= high_mm for place_mm in places_mm)
    yield Finding(
        "stage",
        "pass" if covered else "fail",
        f"travel {low_mm:g} to {high_mm:g} mm, display positions at {places_mm[0]:g} and {places_mm[1]:g} mm",
        "" if covered else "set stage.position_0_mm and stage.position_1_mm within the travel",
    )
    if stage.is_homed():
        yield Finding("stage", "pass", f"homed, at {stage.position_mm():.3f} mm")
    else:
        yield Finding(
            "stage",
            "warn",
            "not homed, so nobody knows where the display is",
            "`rig stage home` tries it; a capture homes by itself before anything else, so keep the way free",
        )


def check_pump(config: RigConfig) -> Iterator[Finding]:
    """Open the pump, look for alarms, and have it prove its safety settings; nothing flows."""
    pump, level_sensor = real_pump(config)
    with pump:
        yield answers("pump", pump)
        state = _state_of_pump(pump)
        yield state
        if state.result != "fail" and isinstance(pump, HasRehearsal):
            yield Finding("pump", "pass", pump.rehearse())
        if config.devices.pump.startswith("new_era:") and config.pump.mode == "basic":
            yield Finding(
                "pump",
                "warn",
                "in Basic mode a computer that dies leaves it running until its volume is moved",
                'set mode = "safe" in section [pump] if the model has it',
            )
        yield from _level(level_sensor, config)


def _state_of_pump(pump: Pump) -> Finding:
    status = pump.status()
    if status.alarm:
        # A board that was just switched on says so; a contact that is open says something is wet.
        result: Result = "warn" if "power was interrupted" in status.alarm else "fail"
        return Finding(
            "pump", result, f"alarm: {status.alarm}", "look at tank, tubing and contacts, then `rig doctor` again"
        )
    if status.running:
        return Finding("pump", "fail", "it turns although it was told to stop", "switch it off at the mains")
    return Finding("pump", "pass", "stands still, no alarm")


def _level(sensor: LevelSensor | None, config: RigConfig) -> Iterator[Finding]:
    if sensor is None:
        yield Finding("level", "look", ASKED_LEVEL)
        return
    volume_ml = sensor.volume_ml()
    free_ml = config.tank.free_volume_ml if config.tank else 0.0
    text = f"the tank holds {volume_ml:.0f} ml of {free_ml:g} ml"
    if volume_ml > free_ml:
        yield Finding(
            "level", "fail", text, "drain the tank (rig pump drain), or correct level_points in section [pump]"
        )
    else:
        yield Finding("level", "pass", text)


def check_display(config: RigConfig, *, page_wait_s: float) -> Iterator[Finding]:
    """Open the display, compare its panel with the configured one, and have it show black."""
    with real_display(config, page_timeout_s=page_wait_s) as display:
        screen, panel = display.screen(), config.display
        yield answers("display", display)
        same = (screen.columns, screen.rows) == (panel.columns, panel.rows)
        yield Finding(
            "display",
            "pass" if same else "fail",
            f"{screen.columns} × {screen.rows} device pixels, {panel.columns} × {panel.rows} configured",
            "" if same else "correct section [display], or the display's full screen, zoom and rotation",
        )
        if isinstance(display, StripePlayer):
            yield from _page(display, settle_s=config.timing.settle_s)
        yield from _shows(display, columns=screen.columns)


def _page(player: StripePlayer, *, settle_s: float) -> Iterator[Finding]:
    report = player.report()
    if report is None:
        return
    if not report.fullscreen:
        yield Finding("display", "warn", "the page is not full-screen", "tap its full-screen button")
    if not report.wake_lock:
        yield Finding(
            "display", "warn", "the page cannot keep the screen awake", "set Auto-Lock to Never on the tablet"
        )
    if 0 < report.refresh_hz < LOW_REFRESH_HZ:
        text = f"it refreshes {report.refresh_hz:.0f} times a second"
        yield Finding("display", "warn", text, "turn off Low Power Mode on the tablet, and plug it in")
    if report.refresh_hz > 0 and settle_s * report.refresh_hz < SETTLED_REFRESHES:
        text = f"settle_s is {settle_s:g}, shorter than two refreshes at {report.refresh_hz:.0f} Hz"
        enough_s = math.ceil(1000 * SETTLED_REFRESHES / report.refresh_hz) / 1000
        mend = f"set settle_s = {enough_s:g} or more in section [timing]"
        yield Finding("display", "warn", text, mend)


def _shows(display: Display, *, columns: int) -> Iterator[Finding]:
    dark = Frame(axis="x", levels=np.zeros(columns, dtype=np.uint8))
    display.show(dark, frame_id=0, timeout_s=SHOW_S)
    yield Finding("display", "pass", "a black frame was shown and acknowledged")
