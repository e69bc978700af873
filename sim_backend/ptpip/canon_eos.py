"""A Canon EOS 40D: the body of the paper, as it speaks to a host over PTP.

Canon publishes nothing of it; codes and layouts are those that libgphoto2's authors observed. The body reports every change of a
setting, and every photo, in a list of records that the host fetches with GetEvent (0x9116). A photo goes to the card, or
with CaptureDestination "host" stays in the body's memory until the host has fetched it.
"""

import struct
import threading
import time
from fractions import Fraction

from sim_backend.exif import Exposure
from sim_backend.ptpip.body import (
    DEVICE_BUSY,
    INVALID_PARAMETER,
    INVALID_PROPERTY_VALUE,
    OBJECT_ADDED,
    PHOTO_FOLDER,
    PROPERTY_NOT_SUPPORTED,
    STORAGE,
    Body,
    Reply,
    Request,
)
from sim_backend.ptpip.datasets import UINT32, BodyInfo, Property, StoredObject, array_u32
from sim_backend.ptpip.sources import Photographs

REMOTE_RELEASE = 0x910F
OBJECT_ADDED_RECORD, REQUEST_TRANSFER, VALUE_CHANGED, CHOICES_CHANGED, CAMERA_STATUS = (
    0xC181,
    0xC186,
    0xC189,
    0xC18A,
    0xC18B,
)
CAPTURE_DESTINATION, AVAILABLE_SHOTS, IMAGE_FORMAT, VIEWFINDER_OUTPUT = 0xD11C, 0xD11B, 0xD120, 0xD1B0
TO_CARD, TO_HOST = 2, 4
# An image format is a count of files, then for each file four numbers: the length of this entry, its type (1 JPEG, 6 RAW),
# its size (0 large, 2 small), its compression (3 fine JPEG, 4 lossless RAW).
LARGE_FINE_JPEG = (1, 0x10, 1, 0, 3)
SMALL_FINE_JPEG = (1, 0x10, 1, 2, 3)
RAW_AND_LARGE_FINE_JPEG = (2, 0x10, 6, 0, 4, 0x10, 1, 0, 3)
FORMATS = (LARGE_FINE_JPEG, SMALL_FINE_JPEG, RAW_AND_LARGE_FINE_JPEG)
RAW = 0xB103
# A RAW file is a TIFF; the emulated one holds the JPEG's bytes behind the header, and no picture.
TIFF_HEADER = b"II*\0"
VIEWFINDER_JPEG = 1
APERTURE, EXPOSURE_TIME, SENSITIVITY = 0xD101, 0xD102, 0xD103
# What the values of these properties stand for.
F_NUMBERS = {0x28: Fraction(4), 0x30: Fraction(56, 10), 0x38: Fraction(8), 0x40: Fraction(11)}
TIMES_S = {
    **{0x40: Fraction(1, 2), 0x48: Fraction(1, 4), 0x50: Fraction(1, 8), 0x58: Fraction(1, 15)},
    **{0x60: Fraction(1, 30), 0x68: Fraction(1, 60)},
}
SENSITIVITIES = {0x48: 100, 0x50: 200, 0x58: 400}
PROPERTIES = (
    Property(APERTURE, UINT32, 0x38, tuple(F_NUMBERS)),
    Property(EXPOSURE_TIME, UINT32, 0x48, tuple(TIMES_S)),
    Property(SENSITIVITY, UINT32, 0x48, tuple(SENSITIVITIES)),
    Property(0xD105, UINT32, 3),  # exposure mode: manual; the dial on the body sets it
    Property(0xD106, UINT32, 0, (0, 1)),  # drive: single, continuous
    Property(0xD108, UINT32, 3, (0, 3)),  # focus: one shot, manual
    Property(0xD109, UINT32, 1, (0, 1, 3)),  # white balance: automatic, daylight, tungsten
    Property(AVAILABLE_SHOTS, UINT32, 800),
    Property(CAPTURE_DESTINATION, UINT32, TO_CARD, (TO_CARD, TO_HOST)),
    Property(VIEWFINDER_OUTPUT, UINT32, 0, (0, 1, 2)),
)


class CanonEos40D(Body):
    """Implements remote capture, settings, and live view of the 40D's generation."""

    captures = frozenset({REMOTE_RELEASE})

    def __init__(self, photographs: Photographs, *, exposure_s: float, download_s: float) -> None:
        super().__init__(photographs, exposure_s=exposure_s, download_s=download_s)
        self.properties = {prop.code: prop for prop in PROPERTIES}
        self._image_format: tuple[int, ...] = LARGE_FINE_JPEG
        self._records: list[bytes] = []
        self._records_lock = threading.Lock()
        self._reading_out = threading.Lock()
        self.add_operations(
            {
                0x9101: lambda _request: Reply(data=array_u32([STORAGE])),
                0x9102: self._get_storage_info_of_canon,
                0x9110: self._set_property_value,
                REMOTE_RELEASE: self._remote_release,
                0x9114: lambda _request: Reply(),  # remote mode: keys and dials of the body stay as they are
                0x9115: self._set_event_mode,
                0x9116: self._get_event,
                0x9117: self._transfer_complete,
                0x911A: self._accept_host_capacity,
                0x911D: lambda _request: Reply(),  # keep the device on: it never sleeps
                0x9127: self._request_property_value,
                0x9153: self._get_viewfinder_data,
            }
        )

    def folder_name(self) -> str:
        """Return the folder as Canon names it."""
        return "100CANON"

    def describe(self) -> BodyInfo:
        """Say what this camera is; the serial number says that it is none."""
        return BodyInfo(
            manufacturer="Canon Inc.",
            model="Canon EOS 40D",
            version="3-1.0.5",
            serial="EMULATED-0040",
            vendor_extension=0xB,
            operations=self.operations(),
            events=(OBJECT_ADDED, 0xC101),
            properties=(),
        )

    def close(self) -> None:
        """End the session; records that nobody fetched are dropped with it."""
        super().close()
        with self._records_lock:
            self._records.clear()

    def writes_to_card(self) -> bool:
        """Tell whether the capture destination is the card."""
        return self.properties[CAPTURE_DESTINATION].value == TO_CARD

    def exposure(self) -> Exposure:
        """Return the exposure that the settings ask for."""
        return Exposure(
            TIMES_S[self.properties[EXPOSURE_TIME].value],
            F_NUMBERS[self.properties[APERTURE].value],
            SENSITIVITIES[self.properties[SENSITIVITY].value],
        )

    def announce(self, *stored: StoredObject) -> None:
        """Queue the records that tell of photos."""
        self._queue(*map(self._record_of_photo, stored))

    def _record_of_photo(self, stored: StoredObject) -> tuple[int, bytes]:
        name = stored.name.encode("ascii") + b"\0"
        size = len(stored.data)
        if not self.writes_to_card():
            return REQUEST_TRANSFER, struct.pack("<5I", stored.handle, stored.format, 0, size, 0) + name
        head = struct.pack("<6I", stored.handle, STORAGE, stored.format, 0, 0, size)
        return OBJECT_ADDED_RECORD, head + struct.pack("<II", PHOTO_FOLDER, stored.handle) + name

    def _queue(self, *records: tuple[int, bytes]) -> None:
        with self._records_lock:
            self._records += [struct.pack("<II", 8 + len(body), code) + body for code, body in records]

    def _remote_release(self, _request: Request) -> Reply:
        """Answer when the shutter has closed; the result in the response's parameter is 0 for a photo taken."""
        if not self._reading_out.acquire(blocking=False):
            return Reply(DEVICE_BUSY)
        self._queue((CAMERA_STATUS, struct.pack("<I", 1)))
        closed_s = self.open_and_close_shutter()
        if self.readout_s > 0:
            threading.Thread(target=self._read_out, args=(closed_s,), name="readout", daemon=True).start()
        else:
            self._read_out(closed_s)
        return Reply(parameters=(0,))

    def _read_out(self, closed_s: float) -> None:
        """Make the files of what was seen, and tell of them once the sensor is read out."""
        stored: list[StoredObject] = []
        try:
            if self.faults.happens("lost"):
                return
            if self.faults.happens("stray_in_capture"):
                stored.append(self.store_stray())
            data = self.develop()
            if self._image_format == RAW_AND_LARGE_FINE_JPEG:
                stored.append(self.store(TIFF_HEADER + data, kind=RAW))
            stored.append(self.store(data if self.writes_to_card() else self.cut_short(data)))
            time.sleep(max(0.0, closed_s + self.readout_s - time.monotonic()))
        finally:
            self._reading_out.release()
            self.announce(*stored)
            self._queue((CAMERA_STATUS, struct.pack("<I", 0)))

    # Settings

    def _set_event_mode(self, _request: Request) -> Reply:
        """Begin to report: first of all every setting and its choices."""
        for prop in self.properties.values():
            self._report(prop)
            if prop.choices:
                values = struct.pack(f"<{len(prop.choices)}I", *prop.choices)
                self._queue((CHOICES_CHANGED, struct.pack("<III", prop.code, 3, len(prop.choices)) + values))
        self._report_image_format()
        formats = b"".join(struct.pack(f"<{len(known)}I", *known) for known in FORMATS)
        self._queue((CHOICES_CHANGED, struct.pack("<III", IMAGE_FORMAT, 3, len(FORMATS)) + formats))
        return Reply()

    def _report(self, prop: Property) -> None:
        none_left = prop.code == AVAILABLE_SHOTS and self.faults.no_shots_left
        self._queue((VALUE_CHANGED, struct.pack("<II", prop.code, 0 if none_left else prop.value)))

    def _report_image_format(self) -> None:
        self._queue((VALUE_CHANGED, struct.pack(f"<{1 + len(self._image_format)}I", IMAGE_FORMAT, *self._image_format)))

    def _get_event(self, _request: Request) -> Reply:
        with self._records_lock:
            records, self._records = self._records, []
        return Reply(data=b"".join(records) + struct.pack("<II", 8, 0))

    def _set_property_value(self, request: Request) -> Reply:
        """Set one property: ``u32 size, u32 property``, then its value."""
        if len(request.data) < 12:
            return Reply(INVALID_PARAMETER)
        _size, code, value = struct.unpack_from("<III", request.data)
        if code == IMAGE_FORMAT:
            return self._set_image_format(request.data[8:])
        prop = self.properties.get(code)
        if prop is None:
            return Reply(PROPERTY_NOT_SUPPORTED)
        if value not in prop.choices:
            return Reply(INVALID_PROPERTY_VALUE)
        self.set_property(code, value)
        self._report(self.properties[code])
        return Reply()

    def _set_image_format(self, data: bytes) -> Reply:
        wanted = struct.unpack(f"<{len(data) // 4}I", data)
        for known in FORMATS:
            if wanted[: len(known)] == known:
                self._image_format = known
                self._report_image_format()
                return Reply()
        return Reply(INVALID_PROPERTY_VALUE)

    def _request_property_value(self, request: Request) -> Reply:
        """Report one property again."""
        prop = self.properties.get(request.parameter(0))
        if prop is None:
            return Reply(PROPERTY_NOT_SUPPORTED)
        self._report(prop)
        return Reply()

    def _accept_host_capacity(self, _request: Request) -> Reply:
        """Learn how much the host can take; the body then says how many shots that is."""
        self._report(self.properties[AVAILABLE_SHOTS])
        return Reply()

    def _get_storage_info_of_canon(self, request: Request) -> Reply:
        return self.answer(Request(0x1005, request.parameters))

    # Photos on their way to the host

    def _transfer_complete(self, request: Request) -> Reply:
        """Forget a photo that the host has."""
        self.forget(request.parameter(0))
        return Reply()

    def _get_viewfinder_data(self, _request: Request) -> Reply:
        """Return one live-view frame: records ``u32 size, u32 type`` of which type 1 is a JPEG."""
        if self.properties[VIEWFINDER_OUTPUT].value == 0:
            return Reply(DEVICE_BUSY)
        picture = self.live_view()
        return Reply(data=struct.pack("<II", 8 + len(picture), VIEWFINDER_JPEG) + picture)
