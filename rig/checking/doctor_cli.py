"""``rig doctor``: what is wrong with the rig, and how to mend it."""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from rig import options
from rig.checking.doctor import Check, Finding, Result, failed, run_checks
from rig.checking.doctor_camera import CAMERA_OFF, PHOTO_TIMEOUT_S, check_camera, check_usb
from rig.checking.doctor_devices import SHOW_S, check_display, check_pump, check_stage
from rig.checking.doctor_machine import check_disk, check_packages, check_tank, read_config
from rig.config import DEFAULT_FILE, RigConfig

console = Console(soft_wrap=True, highlight=False)
COLOURS: dict[Result, str] = {"pass": "green", "fail": "bold red", "warn": "yellow", "skipped": "dim", "look": "cyan"}
PAGE_WAIT_S = 30.0
# How each device is named in the configuration, for one that is not.
EXAMPLES = {
    "camera": 'camera = "gphoto2:usb:"',
    "display": 'display = "browser:"',
    "stage": 'stage = "grbl:/dev/ttyUSB0"',
    "pump": 'pump = "new_era:/dev/ttyUSB1"',
}
NOT_VISIBLE = (
    ("camera", "auto power-off is off, the lens is on manual focus, stabilisation is off"),
    ("tablet", "Auto-Lock is Never, full brightness; True Tone, Night Shift and auto-brightness are off"),
    ("water", "a drip tray is under tank and pump, the hose has an anti-siphon break, nothing leaks"),
    ("mains", "pump and display hang on an RCD (ground-fault) socket; camera and computer stand above the water"),
)


@dataclass(frozen=True, slots=True)
class Limits:
    """How long each check may take, in seconds; a device's driver gives up earlier, with a better sentence."""

    machine_s: float = 20.0
    camera_s: float = 90.0
    stage_s: float = 20.0
    pump_s: float = 20.0
    page_wait_s: float = PAGE_WAIT_S


def plan_checks(
    config: RigConfig | None, *, unread: bool, folder: Path, photos: int, limits: Limits
) -> tuple[Check, ...]:
    """Return the checks that make sense for this configuration; ``unread`` when there is one that cannot be read."""

    def machine(name: str, examine: functools.partial[Iterator[Finding]]) -> Check:
        return Check(name, examine, limits.machine_s, "run `rig doctor` again; the disk may be slow")

    checks = [machine("packages", functools.partial(check_packages))]
    address = config.devices.camera if config else ""
    if not unread and (not address or address.startswith("gphoto2:usb:")):
        usb = functools.partial(check_usb, address.removeprefix("gphoto2:") or "usb:")
        checks.append(machine("camera on USB", usb))
    if config is None:
        checks += [_missing(name, unread=unread) for name in EXAMPLES]
        return (*checks, *(_waits_for_configuration(name) for name in ("tank", "disk")))
    devices = {
        "camera": Check(
            "camera",
            functools.partial(check_camera, config, photos=photos),
            limits.camera_s + photos * PHOTO_TIMEOUT_S,
            CAMERA_OFF,
        ),
        "display": Check(
            "display",
            functools.partial(check_display, config, page_wait_s=limits.page_wait_s),
            limits.page_wait_s + 2 * SHOW_S,
            "open the page that `rig display screen` announces on the display",
        ),
        "stage": Check(
            "stage",
            functools.partial(check_stage, config),
            limits.stage_s,
            "switch the controller on, look at cable and port, then `rig stage where`",
        ),
        "pump": Check(
            "pump",
            functools.partial(check_pump, config),
            limits.pump_s,
            "switch the pump on, look at cable and port, then `rig pump stop`",
        ),
    }
    addresses = config.devices.model_dump()
    for name, check in devices.items():
        if name == "pump" and not (config.tank and config.tank.has_pump):
            continue
        checks.append(check if addresses[name] else _missing(name, unread=False))
    checks.append(machine("tank", functools.partial(check_tank, config)))
    checks.append(machine("disk", functools.partial(check_disk, config, folder)))
    return tuple(checks)


def _missing(name: str, *, unread: bool) -> Check:
    """Return the check of a device that no configuration names."""
    finding = (
        Finding(name, "skipped", "the configuration cannot be read", "mend the configuration first")
        if unread
        else Finding(name, "fail", "not configured", f"in section [devices] of the configuration: {EXAMPLES[name]}")
    )
    return Check(name, lambda: (finding,), 5.0, "")


def _waits_for_configuration(name: str) -> Check:
    finding = Finding(name, "skipped", "compared with the plan, which needs a configuration")
    return Check(name, lambda: (finding,), 5.0, "")


def show(finding: Finding) -> None:
    """Print one finding: its result, what was found, and below that what mends it."""
    console.print(f"{finding.result:8}", style=COLOURS[finding.result], end="")
    console.print(f"{finding.name:16} {finding.found}", markup=False)
    if finding.mend:
        console.print(f"{'':25}-> {finding.mend}", markup=False)


def doctor(
    config: options.ConfigOption = None,
    session: Annotated[
        Path, typer.Option("--session", metavar="DIR", help="Where the session will be, for the space on its disk.")
    ] = Path(),
    photos: Annotated[int, typer.Option("--photos", min=0, help="How many photos to time; none of them is kept.")] = 3,
    page_wait_s: Annotated[
        float, typer.Option("--page-wait", metavar="SECONDS", min=1.0, help="How long to wait for the display's page.")
    ] = PAGE_WAIT_S,
) -> None:
    """Say what is wrong with the rig and how to mend it, before water flows.

    Nothing moves and no liquid flows: devices are opened, asked, and closed. The camera takes a few photos and the display
    shows black. Every line passes or fails; below one that does not pass stands what mends it. Exit status 1 if any fails.
    """
    path = config or DEFAULT_FILE
    rig_config, first = read_config(path)
    findings = [first]
    show(first)
    checks = plan_checks(
        rig_config,
        unread=rig_config is None and path.exists(),
        folder=session,
        photos=photos,
        limits=Limits(page_wait_s=page_wait_s),
    )
    for finding in run_checks(checks):
        show(finding)
        findings.append(finding)
    for name, text in NOT_VISIBLE:
        show(Finding(name, "look", text))
    count, warnings = failed(findings), sum(finding.result == "warn" for finding in findings)
    verdict = f"{count} to mend before a capture" if count else "ready for a capture"
    console.print(f"{verdict}, {warnings} to think about; `look` lines are for your own eyes", markup=False)
    if count:
        raise typer.Exit(1)
