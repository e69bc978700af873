"""The datasets that a PTP device sends: strings, arrays, and what it says of itself, its card, its photos, its properties.

Field by field from PIMA 15740 (ISO 15740), section 5; everything is little endian.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace

UINT8, UINT16, UINT32 = 0x0002, 0x0004, 0x0006
FORMATS = {UINT8: "B", UINT16: "H", UINT32: "I"}
JPEG, ASSOCIATION = 0x3801, 0x3001


def ptp_string(text: str) -> bytes:
    """Return a PTP string: the count of characters with the closing zero, then UTF-16; empty is one zero byte."""
    if not text:
        return b"\0"
    return bytes([len(text) + 1]) + text.encode("utf-16-le") + b"\0\0"


def array_u16(values: Sequence[int]) -> bytes:
    """Return an array of 16-bit numbers."""
    return struct.pack(f"<I{len(values)}H", len(values), *values)


def array_u32(values: Sequence[int]) -> bytes:
    """Return an array of 32-bit numbers."""
    return struct.pack(f"<I{len(values)}I", len(values), *values)


@dataclass(frozen=True, slots=True)
class BodyInfo:
    """What a camera says of itself in DeviceInfo."""

    manufacturer: str
    model: str
    version: str
    serial: str
    vendor_extension: int
    operations: tuple[int, ...]
    events: tuple[int, ...]
    properties: tuple[int, ...]

    def dataset(self) -> bytes:
        """Return the DeviceInfo dataset (section 5.5.1)."""
        return b"".join(
            [
                struct.pack("<HIH", 100, self.vendor_extension, 100),
                ptp_string(""),
                struct.pack("<H", 0),
                array_u16(self.operations),
                array_u16(self.events),
                array_u16(self.properties),
                array_u16([JPEG]),
                array_u16([ASSOCIATION, JPEG]),
                *(ptp_string(text) for text in (self.manufacturer, self.model, self.version, self.serial)),
            ]
        )


@dataclass(frozen=True, slots=True)
class StoredObject:
    """A photo or a folder on the card."""

    handle: int
    parent: int
    name: str
    data: bytes
    format: int = JPEG

    def info(self, *, storage: int) -> bytes:
        """Return the ObjectInfo dataset (section 5.5.2)."""
        is_folder = self.format == ASSOCIATION
        head = struct.pack("<IHHI", storage, self.format, 0, len(self.data))
        no_thumbnail = struct.pack("<HIII", 0, 0, 0, 0)
        picture = struct.pack("<III", 0, 0, 0)
        place = struct.pack("<IHII", self.parent, 1 if is_folder else 0, 0, 0)
        date = ptp_string("20180101T000000")
        return head + no_thumbnail + picture + place + ptp_string(self.name) + date + date + ptp_string("")


def storage_info(*, capacity_bytes: int, free_bytes: int, free_photos: int) -> bytes:
    """Return the StorageInfo dataset (section 5.5.3) of a removable card in camera format."""
    sizes = struct.pack("<HHHQQI", 0x0004, 0x0003, 0x0000, capacity_bytes, free_bytes, free_photos)
    return sizes + ptp_string("emulated card") + ptp_string("")


@dataclass(frozen=True, slots=True)
class Property:
    """One setting: its type, its value and the values it may take (none listed: read only)."""

    code: int
    type: int
    value: int
    choices: tuple[int, ...] = ()

    def packed(self) -> bytes:
        """Return the current value as it travels."""
        return struct.pack("<" + FORMATS[self.type], self.value)

    def unpacked(self, data: bytes) -> int | None:
        """Return the value in ``data``, or None if it is none of the choices."""
        size = struct.calcsize(FORMATS[self.type])
        if len(data) < size:
            return None
        (value,) = struct.unpack_from("<" + FORMATS[self.type], data)
        return value if value in self.choices else None

    def with_value(self, value: int) -> "Property":
        """Return the property with another value."""
        return replace(self, value=value)

    def description(self) -> bytes:
        """Return the DevicePropDesc dataset (section 13.3.3): default, current value and enumeration."""
        form = FORMATS[self.type]
        head = struct.pack(f"<HHB{form}{form}", self.code, self.type, bool(self.choices), self.value, self.value)
        if not self.choices:
            return head + b"\0"
        return head + struct.pack(f"<BH{len(self.choices)}{form}", 2, len(self.choices), *self.choices)
