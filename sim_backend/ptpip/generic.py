"""A PTP camera of no particular maker: it takes photos with InitiateCapture and tells of them with events.

Property codes and the units of their values are those of PIMA 15740, section 13.3.5: exposure times in tenths of a millisecond,
f-numbers in hundredths.
"""

import threading
import time
from fractions import Fraction

from sim_backend.exif import Exposure
from sim_backend.ptpip.body import (
    CAPTURE_COMPLETE,
    DEVICE_BUSY,
    INVALID_PROPERTY_VALUE,
    OBJECT_ADDED,
    PROPERTY_NOT_SUPPORTED,
    Body,
    Reply,
    Request,
)
from sim_backend.ptpip.datasets import UINT8, UINT16, UINT32, BodyInfo, Property
from sim_backend.ptpip.sources import Photographs

INITIATE_CAPTURE = 0x100E
F_NUMBER, EXPOSURE_TIME, EXPOSURE_INDEX = 0x5007, 0x500D, 0x500F
PROPERTIES = (
    Property(0x5001, UINT8, 100),  # battery level, per cent
    Property(0x5005, UINT16, 4, (2, 4, 6)),  # white balance: automatic, daylight, tungsten
    Property(F_NUMBER, UINT16, 800, (400, 560, 800, 1100)),  # f-number
    Property(0x500A, UINT16, 1, (1, 2)),  # focus: manual, automatic
    Property(EXPOSURE_TIME, UINT32, 2500, (625, 1250, 2500, 5000)),  # exposure time
    Property(0x500E, UINT16, 1, (1, 2)),  # exposure program: manual, automatic
    Property(EXPOSURE_INDEX, UINT16, 100, (100, 200, 400)),  # exposure index
)


class GenericBody(Body):
    """Implements the operations and events of PIMA 15740 that a remote capture needs."""

    captures = frozenset({INITIATE_CAPTURE})

    def __init__(self, photographs: Photographs, *, exposure_s: float, download_s: float) -> None:
        super().__init__(photographs, exposure_s=exposure_s, download_s=download_s)
        self.properties = {prop.code: prop for prop in PROPERTIES}
        self._exposing = threading.Lock()
        self.add_operations(
            {
                INITIATE_CAPTURE: self._initiate_capture,
                0x1014: self._get_property_description,
                0x1015: self._get_property_value,
                0x1016: self._set_property_value,
            }
        )

    def describe(self) -> BodyInfo:
        """Say what this camera is."""
        return BodyInfo(
            manufacturer="refractive-scan",
            model="Emulated PTP camera",
            version="1.0",
            serial="EMULATED-0001",
            vendor_extension=0,
            operations=self.operations(),
            events=(OBJECT_ADDED, CAPTURE_COMPLETE),
            properties=tuple(self.properties),
        )

    def exposure(self) -> Exposure:
        """Return the exposure that the settings ask for."""
        return Exposure(
            Fraction(self.properties[EXPOSURE_TIME].value, 10_000),
            Fraction(self.properties[F_NUMBER].value, 100),
            self.properties[EXPOSURE_INDEX].value,
        )

    def _initiate_capture(self, _request: Request) -> Reply:
        """Answer at once and expose in the background: the events tell when the photo is there (10.5.14)."""
        if not self._exposing.acquire(blocking=False):
            return Reply(DEVICE_BUSY)
        threading.Thread(target=self._expose, name="exposure", daemon=True).start()
        return Reply()

    def _expose(self) -> None:
        try:
            closed_s = self.open_and_close_shutter()
            if self.faults.happens("lost"):
                return
            strays = [self.store_stray()] if self.faults.happens("stray_in_capture") else []
            stored = self.store(self.develop())
            time.sleep(max(0.0, closed_s + self.readout_s - time.monotonic()))
        finally:
            self._exposing.release()
        self.announce(*strays, stored)
        self.tell((CAPTURE_COMPLETE, ()))

    def _get_property_description(self, request: Request) -> Reply:
        prop = self.properties.get(request.parameter(0))
        return Reply(PROPERTY_NOT_SUPPORTED) if prop is None else Reply(data=prop.description())

    def _get_property_value(self, request: Request) -> Reply:
        prop = self.properties.get(request.parameter(0))
        return Reply(PROPERTY_NOT_SUPPORTED) if prop is None else Reply(data=prop.packed())

    def _set_property_value(self, request: Request) -> Reply:
        prop = self.properties.get(request.parameter(0))
        if prop is None:
            return Reply(PROPERTY_NOT_SUPPORTED)
        value = prop.unpacked(request.data)
        if value is None:
            return Reply(INVALID_PROPERTY_VALUE)
        self.set_property(prop.code, value)
        return Reply()
