"""Cameras on the USB: found by the class of their interface, their holders named, reset and awaited. The bus is a fake one."""

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import usb.backend
from faults_page import OperatorReads

from drivers.errors import DeviceBusyError, DeviceNotFoundError
from drivers.usb_cameras import (
    RULE_FILE,
    UsbCamera,
    find_usb_cameras,
    permission_fault,
    programs_holding,
    reset_usb_camera,
    wait_for_usb_camera,
)

CANON, CANON_40D = 0x04A9, 0x3146
KEYBOARD = (0x046D, 0xC31C, 3)  # a human interface device: class 3
CAMERA = (CANON, CANON_40D, 6)  # still image: class 6


class FakeBus(usb.backend.IBackend):
    """A bus of devices ``(vendor, product, interface class)``; a reset gives the device the next address."""

    def __init__(self, *devices: tuple[int, int, int], refuses_reset: bool = False) -> None:
        self.devices = dict(enumerate(devices, start=4))
        self.refuses_reset = refuses_reset

    def enumerate_devices(self) -> Any:
        return list(self.devices)

    def get_device_descriptor(self, address: int) -> Any:
        vendor, product, _kind = self.devices[address]
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=vendor, idProduct=product, bcdDevice=1, iManufacturer=1, iProduct=2,
            iSerialNumber=0, bNumConfigurations=1, address=address, bus=1, port_number=1, port_numbers=(1,), speed=3,
        )  # fmt: skip

    def get_configuration_descriptor(self, _address: int, index: int) -> Any:
        if index:
            raise IndexError(index)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=32, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0xC0, bMaxPower=1, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, address: int, interface: int, alternate: int, configuration: int) -> Any:
        if interface or alternate or configuration:
            raise IndexError(interface)
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=0,
            bInterfaceClass=self.devices[address][2], bInterfaceSubClass=1, bInterfaceProtocol=1, iInterface=0,
            extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, address: int) -> int:
        return address

    def close_device(self, handle: int) -> None:
        pass

    def reset_device(self, address: int) -> None:
        if self.refuses_reset:
            raise usb.core.USBError("Access denied", errno=13)
        self.devices[max(self.devices) + 1] = self.devices.pop(address)


def test_a_camera_is_known_by_its_still_image_interface() -> None:
    assert find_usb_cameras(backend=FakeBus(KEYBOARD, CAMERA)) == (UsbCamera(1, 5, CANON, CANON_40D),)
    assert find_usb_cameras(backend=FakeBus(KEYBOARD)) == ()


def test_the_address_is_written_as_libgphoto2_writes_it() -> None:
    assert UsbCamera(1, 5, CANON, CANON_40D).port == "usb:001,005"
    assert UsbCamera(12, 105, CANON, CANON_40D).port == "usb:012,105"


def test_a_reset_returns_the_camera_with_its_new_address() -> None:
    bus = FakeBus(CAMERA, KEYBOARD)
    (camera,) = find_usb_cameras(backend=bus)
    back = reset_usb_camera(camera, timeout_s=1.0, backend=bus)
    assert (camera.device, back.device) == (4, 6)
    assert find_usb_cameras(backend=bus) == (back,)


def test_a_camera_that_is_not_there_cannot_be_reset(operator_reads: OperatorReads) -> None:
    with operator_reads.raised(DeviceNotFoundError):
        reset_usb_camera(UsbCamera(1, 9, CANON, CANON_40D), timeout_s=1.0, backend=FakeBus(CAMERA))


def test_a_reset_that_the_system_refuses_says_so(operator_reads: OperatorReads) -> None:
    bus = FakeBus(CAMERA, refuses_reset=True)
    (camera,) = find_usb_cameras(backend=bus)
    with operator_reads.raised(DeviceBusyError):
        reset_usb_camera(camera, timeout_s=1.0, backend=bus)


def test_a_camera_is_awaited_until_it_is_back() -> None:
    gone = UsbCamera(1, 5, CANON, CANON_40D)
    back = UsbCamera(1, 6, CANON, CANON_40D)
    another = UsbCamera(1, 7, 0x04B0, 0x0437)
    looks = iter([(), (another,), (another, back)])
    assert wait_for_usb_camera(gone, timeout_s=10.0, find=lambda: next(looks)) == back


def test_a_camera_that_does_not_come_back_is_an_error(operator_reads: OperatorReads) -> None:
    with operator_reads.raised(DeviceNotFoundError):
        wait_for_usb_camera(UsbCamera(1, 5, CANON, CANON_40D), timeout_s=0.1, find=lambda: ())


def process(proc: Path, number: int, name: str, *open_files: str) -> None:
    (proc / str(number) / "fd").mkdir(parents=True)
    (proc / str(number) / "comm").write_text(name + "\n", encoding="utf-8")
    for index, target in enumerate(open_files):
        os.symlink(target, proc / str(number) / "fd" / str(index))


def test_the_programs_that_hold_a_camera_are_named(tmp_path: Path) -> None:
    process(tmp_path, 17, "gvfsd-gphoto2", "/dev/null", "/dev/bus/usb/001/005")
    process(tmp_path, 4, "darktable", "/dev/bus/usb/001/005")
    process(tmp_path, 99, "bash", "/dev/bus/usb/001/004", "/dev/tty1")
    (tmp_path / "5").mkdir()  # one that we may not look into
    camera = UsbCamera(1, 5, CANON, CANON_40D)
    assert programs_holding(camera, proc=tmp_path) == ("darktable (4)", "gvfsd-gphoto2 (17)")
    assert programs_holding(UsbCamera(1, 6, CANON, CANON_40D), proc=tmp_path) == ()


def test_this_very_process_is_found_holding_a_file(tmp_path: Path) -> None:
    node = tmp_path / "bus" / "usb" / "001" / "005"
    node.parent.mkdir(parents=True)
    with node.open("wb"):
        found = programs_holding(UsbCamera(1, 5, CANON, CANON_40D))
    assert any(f"({os.getpid()})" in program for program in found)


def test_a_missing_permission_comes_with_the_rule_that_gives_it(
    operator_reads: OperatorReads, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = UsbCamera(1, 5, CANON, CANON_40D)
    operator_reads(permission_fault(camera, usb_devices=tmp_path))
    node = tmp_path / "001" / "005"
    node.parent.mkdir()
    node.touch()
    assert permission_fault(camera, usb_devices=tmp_path) is None
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)  # root may do everything
    operator_reads(permission_fault(camera, usb_devices=tmp_path))


def test_the_rule_is_one_line_for_still_image_interfaces() -> None:
    rules = [line for line in RULE_FILE.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    assert len(rules) == 1
    # udev lists interfaces as :CCSSPP:, class, subclass and protocol: still image is 06, 01, 01.
    assert 'ENV{ID_USB_INTERFACES}=="*:060101:*"' in rules[0]
