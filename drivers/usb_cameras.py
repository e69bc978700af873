"""Cameras on the USB, seen without opening them: which there are, who holds them, may we use them, and a reset.

Still-image cameras say so in an interface of class 6 (USB Still Image Capture Device Definition 1.0). Written from that text
and from pyusb's manual; has not met real hardware.
"""

import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import DeviceBusyError, DeviceNotFoundError

STILL_IMAGE_CLASS = 6
RULE_FILE = Path(__file__).with_name("70-refractive-scan-camera.rules")
RULE_PLACE = Path("/etc/udev/rules.d") / RULE_FILE.name
POLL_S = 0.2


@dataclass(frozen=True, slots=True)
class UsbCamera:
    """A camera on the bus. ``port`` is the address as libgphoto2 writes it."""

    bus: int
    device: int
    vendor_id: int
    product_id: int

    @property
    def port(self) -> str:
        """The address, such as ``usb:001,005``; its last number changes whenever the camera is plugged in."""
        return f"usb:{self.bus:03d},{self.device:03d}"

    @property
    def node(self) -> str:
        """The device file below ``/dev/bus/usb``."""
        return f"{self.bus:03d}/{self.device:03d}"


def find_usb_cameras(*, backend: Any = None) -> tuple[UsbCamera, ...]:
    """Return every device with a still-image interface, in the order of the bus.

    Raises
    ------
    DeviceNotFoundError
        When the library libusb is not installed; ``backend`` is one of pyusb's, for tests.
    """
    return tuple(
        sorted((_described(device) for device in _find(backend)), key=lambda camera: (camera.bus, camera.device))
    )


def _find(backend: Any) -> list[Any]:
    import usb.core  # here: only a rig with a camera on the USB needs it

    try:
        found = usb.core.find(find_all=True, backend=backend, custom_match=_is_still_image)
        return list(found)
    except usb.core.NoBackendError:
        raise DeviceNotFoundError(
            "camera: the library libusb was not found; on Debian: apt-get install libusb-1.0-0"
        ) from None


def _is_still_image(device: Any) -> bool:
    import usb.core

    if device.bDeviceClass == STILL_IMAGE_CLASS:
        return True
    try:
        return any(
            interface.bInterfaceClass == STILL_IMAGE_CLASS for configuration in device for interface in configuration
        )
    except usb.core.USBError:
        return False  # its descriptors cannot be read: nothing is known of it


def _described(device: Any) -> UsbCamera:
    return UsbCamera(device.bus, device.address, device.idVendor, device.idProduct)


def programs_holding(camera: UsbCamera, *, proc: Path = Path("/proc")) -> tuple[str, ...]:
    """Return the programs that have the camera's device file open, as ``name (process id)``.

    Only processes that we may look into are seen: those of the same user, or all of them for root.
    """
    wanted = f"/bus/usb/{camera.node}"
    found = []
    for process in sorted(proc.glob("[0-9]*"), key=lambda path: int(path.name)):
        if any(target.endswith(wanted) for target in _open_files(process)):
            with contextlib.suppress(OSError):  # it ended meanwhile
                found.append(f"{(process / 'comm').read_text(encoding='utf-8').strip()} ({process.name})")
    return tuple(found)


def _open_files(process: Path) -> list[str]:
    """Return what a process has open, as far as we may see it; files come and go while we look."""
    targets = []
    with contextlib.suppress(OSError):
        for link in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                targets.append(os.readlink(link))
    return targets


def permission_fault(camera: UsbCamera, *, usb_devices: Path = Path("/dev/bus/usb")) -> str | None:
    """Say in a sentence that this user may not use the camera and what to do, or return None."""
    node = usb_devices / camera.node
    if not node.exists():
        return f"{node} does not exist; plug the camera in again"
    if not os.access(node, os.R_OK | os.W_OK):
        return (
            f"{node} may not be read and written by this user; install the rule: "
            f"sudo cp '{RULE_FILE}' {RULE_PLACE} && sudo udevadm control --reload, then plug the camera in again"
        )
    return None


def reset_usb_camera(camera: UsbCamera, *, timeout_s: float, backend: Any = None) -> UsbCamera:
    """Reset the camera's USB port and wait until it is back; return it with its new address.

    Raises
    ------
    DeviceNotFoundError
        When it is not there, or does not come back in time.
    DeviceBusyError
        When the system does not let us reset it.
    """
    import usb.core

    matching = [device for device in _find(backend) if _described(device) == camera]
    if not matching:
        raise DeviceNotFoundError(f"camera {camera.port}: a reset asked, it is not on the USB; switch it on")
    try:
        matching[0].reset()
    except usb.core.USBError as error:
        raise DeviceBusyError(
            f"camera {camera.port}: a reset asked, the system refused ({error}); plug it in again"
        ) from None
    return wait_for_usb_camera(camera, timeout_s=timeout_s, find=lambda: find_usb_cameras(backend=backend))


def wait_for_usb_camera(
    camera: UsbCamera, *, timeout_s: float, find: Callable[[], tuple[UsbCamera, ...]] = find_usb_cameras
) -> UsbCamera:
    """Wait for a camera of the same maker and model, whatever address it comes back with."""
    end_s = time.monotonic() + timeout_s
    while True:
        for found in find():
            if (found.vendor_id, found.product_id) == (camera.vendor_id, camera.product_id):
                return found
        if time.monotonic() > end_s:
            raise DeviceNotFoundError(
                f"camera {camera.port}: did not come back within {timeout_s:g} s of its reset; switch it off and on"
            )
        time.sleep(POLL_S)
