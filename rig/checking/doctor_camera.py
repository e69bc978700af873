"""The doctor's checks of the camera: on the USB before it is opened, then its settings, then a few photos."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol, runtime_checkable

from drivers.exposure_time import seconds_of
from drivers.protocols import Camera, Photo
from drivers.usb_cameras import UsbCamera, find_usb_cameras, permission_fault, programs_holding
from recon.sessions.photos import decode_grey
from rig.checking.doctor import INSTALL, Finding, finding_of_sentence
from rig.checking.doctor_devices import answers
from rig.config import RigConfig
from rig.devices import real_camera

NAME = "camera"
PHOTO_TIMEOUT_S = 30.0
# Above these, the plan's time or disk space would be a promise that cannot be kept.
SLOWER_THAN_PLANNED = 1.25
LARGER_THAN_PLANNED = 1.25
# Two refreshes of a display of 60 Hz; a shorter exposure sees bands (backlights and pixels are driven by refresh).
SHORTEST_EXPOSURE_S = 2 / 60
LOW_BATTERY_PERCENT = 25
CAMERA_OFF = "connect the camera by USB, switch it on, and turn off its auto power-off"


@runtime_checkable
class HasBattery(Protocol):
    """A camera that knows its charge."""

    def battery(self) -> str:
        """Return the charge in the camera's own words; empty where it does not tell."""
        ...


def check_usb(wanted: str) -> Iterator[Finding]:
    """Look for still-image devices on the USB, and at who else wants them.

    ``wanted`` is the port of one of them, or ``usb:`` for the only one.
    """
    name = "camera on USB"
    try:
        cameras = find_usb_cameras()
    except ImportError:
        yield Finding(name, "skipped", "the package pyusb is not installed", INSTALL)
        return
    if not cameras:
        yield Finding(name, "fail", "no still-image device (USB class 6)", CAMERA_OFF)
        return
    if wanted == "usb:" and len(cameras) > 1:
        ports = ", ".join(camera.port for camera in cameras)
        yield Finding(
            name, "fail", f"{len(cameras)} of them: {ports}", f'choose one: camera = "gphoto2:{cameras[0].port}"'
        )
    if wanted != "usb:" and wanted not in {camera.port for camera in cameras}:
        ports = ", ".join(camera.port for camera in cameras)
        yield Finding(name, "fail", f"{wanted} is not there, but {ports}", 'camera = "gphoto2:usb:" finds the only one')
    for camera in cameras:
        if wanted in ("usb:", camera.port):
            yield _usable(name, camera)


def _usable(name: str, camera: UsbCamera) -> Finding:
    fault = permission_fault(camera)
    if fault is not None:
        return finding_of_sentence(name, "fail", fault, mend=CAMERA_OFF)
    programs = programs_holding(camera)
    if programs:
        return Finding(
            name,
            "fail",
            f"{camera.port} is held by {', '.join(programs)}",
            "`gio mount -s gphoto2`, or end that program",
        )
    identity = f"{camera.vendor_id:04x}:{camera.product_id:04x}"
    return Finding(name, "pass", f"{camera.port} ({identity}), held by nobody, this user may use it")


def check_camera(config: RigConfig, *, photos: int) -> Iterator[Finding]:
    """Open the camera, set and read back its settings as a capture does, and time ``photos`` photos."""
    with real_camera(config) as camera:
        yield answers(NAME, camera)
        if isinstance(camera, HasBattery):
            yield _battery(camera.battery())
        yield from _settings(camera, config)
        if photos > 0:
            yield from _photos(camera, config, count=photos)


def _battery(charge: str) -> Finding:
    if not charge:
        return Finding("camera battery", "look", "the camera does not tell; a mains adapter lasts longest")
    percent = charge.removesuffix("%").strip()
    low = float(percent) < LOW_BATTERY_PERCENT if percent.isdecimal() else charge.lower() in ("low", "empty")
    mend = "charge it, or use a mains adapter"
    return Finding("camera battery", "warn", charge, mend) if low else Finding("camera battery", "pass", charge)


def _settings(camera: Camera, config: RigConfig) -> Iterator[Finding]:
    """Apply what is configured; the driver refuses what did not take, autofocus and automatic exposure."""
    camera.apply_settings(dict(config.camera.settings))
    found = camera.settings()
    text = ", ".join(f"{name} {value}" for name, value in found.items())
    if config.camera.settings:
        yield Finding("camera settings", "pass", f"taken and read back: {text}")
    else:
        yield Finding(
            "camera settings",
            "warn",
            f"none are configured, so they stay as they are: {text}",
            "write those that matter into [camera.settings]; `rig camera settings` lists them",
        )
    exposure_s = seconds_of(found.get("shutterspeed", ""))
    if exposure_s is not None and exposure_s < SHORTEST_EXPOSURE_S:
        yield Finding(
            "camera settings",
            "warn",
            f"the exposure of {found['shutterspeed']} s is shorter than two refreshes of a 60 Hz display",
            "choose a multiple of the display's refresh period, at least two of them, and close the aperture instead",
        )


def _photos(camera: Camera, config: RigConfig, *, count: int) -> Iterator[Finding]:
    """Take photos that nobody keeps; their time and size are what the plan counts with."""
    began_s = time.monotonic()
    for _ in range(count):
        camera.expose(timeout_s=PHOTO_TIMEOUT_S)
        files = camera.collect(timeout_s=PHOTO_TIMEOUT_S)
    photo_s = (time.monotonic() - began_s) / count
    planned_s = config.timing.photo_s
    text = f"{photo_s:.2f} s a photo ({count} taken, none kept), {planned_s:g} s planned"
    slow = photo_s > SLOWER_THAN_PLANNED * planned_s
    mend = f"set photo_s = {photo_s:.1f} in section [timing], so that `rig plan` says the truth"
    yield Finding("camera photos", "warn", text, mend) if slow else Finding("camera photos", "pass", text)
    photo_mb = sum(len(file.data) for file in files) / 1e6
    if photo_mb > LARGER_THAN_PLANNED * config.timing.photo_mb:
        text = f"{photo_mb:.1f} MB a photo, {config.timing.photo_mb:g} MB planned"
        yield Finding("camera photos", "warn", text, f"set photo_mb = {photo_mb:.1f} in section [timing]")
    yield from _size(files, config)


def _size(files: tuple[Photo, ...], config: RigConfig) -> Iterator[Finding]:
    jpegs = [file for file in files if file.suffix in (".jpg", ".jpeg")]
    if not jpegs:
        yield Finding("camera photos", "skipped", "the size in pixels is read from JPEG files only")
        return
    rows, columns = decode_grey(jpegs[0].data, Path(jpegs[0].name or "photo.jpg")).shape
    text = f"{columns} × {rows} pixels, {config.camera.columns} × {config.camera.rows} configured"
    if (columns, rows) == (config.camera.columns, config.camera.rows):
        yield Finding("camera photos", "pass", text)
    else:
        mend = f"set columns = {columns} and rows = {rows} in section [camera], or the camera's image size"
        yield Finding("camera photos", "fail", text, mend)
