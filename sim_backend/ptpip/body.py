"""The inside of an emulated camera: its card, its settings, its faults, and the operations that every PTP camera has.

A subclass says what the body is (``describe``) and adds the operations of its maker. Operation codes, response codes and
parameters are those of PIMA 15740, sections 10 and 11.

A photo has three parts: for ``exposure_s`` the shutter is open, then the body reads its sensor out and is busy, then the file
travels. The last two take ``download_s`` together; only the first one sees the scene.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from sim_backend.exif import Exposure, with_exif
from sim_backend.ptpip.datasets import ASSOCIATION, JPEG, BodyInfo, Property, StoredObject, array_u32, storage_info
from sim_backend.ptpip.faults import Faults
from sim_backend.ptpip.sources import Photographs, as_exposing

STORAGE = 0x0001_0001
WHOLE_TREE, ROOT_ONLY = 0x0000_0000, 0xFFFF_FFFF
DCIM_FOLDER, PHOTO_FOLDER = 0x1000_0001, 0x1000_0002
OBJECT_ADDED, CAPTURE_COMPLETE = 0x4002, 0x400D

OK = 0x2001
SESSION_NOT_OPEN = 0x2003
OPERATION_NOT_SUPPORTED = 0x2005
INVALID_STORAGE = 0x2008
INVALID_HANDLE = 0x2009
PROPERTY_NOT_SUPPORTED = 0x200A
STORE_FULL = 0x200C
DEVICE_BUSY = 0x2019
INVALID_PARAMETER = 0x201D
SESSION_ALREADY_OPEN = 0x201E
INVALID_PROPERTY_VALUE = 0x201C

# What is left on a card with room: four gigabytes, and more photos than a capture takes.
CARD_BYTES = 4_000_000_000
CARD_PHOTOS = 9999
# Of the time from the closing of the shutter to the whole file, the share that passes before the photo is announced.
READOUT_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class Request:
    """One operation as the host asked for it."""

    operation: int
    parameters: tuple[int, ...]
    data: bytes = b""

    def parameter(self, index: int) -> int:
        """Return parameter ``index``; one that was not sent is 0 (PIMA 15740, 9.3.2)."""
        return self.parameters[index] if index < len(self.parameters) else 0


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer: a response code, its parameters, and the data of the data phase if there is one."""

    code: int = OK
    parameters: tuple[int, ...] = ()
    data: bytes | None = None


class LinkBrokenError(Exception):
    """The emulated cable was pulled: close the connection without an answer."""


Operation = Callable[[Request], Reply]


class Body:
    """A PTP camera with one card.

    ``tell`` carries events, each a code and its parameters, to the host in one piece; the responder sets it.
    """

    captures: frozenset[int] = frozenset()

    def __init__(self, photographs: Photographs, *, exposure_s: float, download_s: float) -> None:
        self.faults = Faults()
        self.tell: Callable[..., None] = lambda *_events: None
        self.photos_taken = 0
        self.exposure_s = exposure_s
        self.readout_s = READOUT_SHARE * download_s
        self.transfer_s = download_s - self.readout_s
        self.properties: dict[int, Property] = {}
        self._photographs = as_exposing(photographs)
        self._last_photo: bytes | None = None
        self._lock = threading.RLock()
        self._session_open = False
        self._next_handle = 1
        self._objects = {
            DCIM_FOLDER: StoredObject(DCIM_FOLDER, 0, "DCIM", b"", ASSOCIATION),
            PHOTO_FOLDER: StoredObject(PHOTO_FOLDER, DCIM_FOLDER, self.folder_name(), b"", ASSOCIATION),
        }
        self._operations: dict[int, Operation] = {
            0x1001: self._get_device_info,
            0x1002: self._open_session,
            0x1003: self._close_session,
            0x1004: self._get_storage_ids,
            0x1005: self._get_storage_info,
            0x1006: self._get_count,
            0x1007: self._get_handles,
            0x1008: self._get_object_info,
            0x1009: self._get_object,
            0x100B: self._delete_object,
            0x101B: self._get_partial_object,
        }

    def folder_name(self) -> str:
        """Return the name of the folder that photos are put in."""
        return "100EMULA"

    def describe(self) -> BodyInfo:
        """Say what this camera is."""
        raise NotImplementedError

    def add_operations(self, operations: dict[int, Operation]) -> None:
        """Add the operations of a maker."""
        self._operations |= operations

    def operations(self) -> tuple[int, ...]:
        """Return the codes of all operations."""
        return tuple(sorted(self._operations))

    def answer(self, request: Request) -> Reply:
        """Carry out one operation; raises :class:`LinkBrokenError` when the fault of that name is due."""
        if request.operation in self.captures:
            if self.faults.happens("dropped_link"):
                raise LinkBrokenError
            if self.faults.happens("busy"):
                return Reply(DEVICE_BUSY)
            if self.faults.card_full and self.writes_to_card():
                return Reply(STORE_FULL)
        operation = self._operations.get(request.operation)
        if operation is None:
            return Reply(OPERATION_NOT_SUPPORTED)
        if not self._session_open and request.operation not in (0x1001, 0x1002):
            return Reply(SESSION_NOT_OPEN)
        return operation(request)

    def close(self) -> None:
        """End the session, as a lost connection does."""
        self._session_open = False

    # Photos

    def writes_to_card(self) -> bool:
        """Tell whether the next photo goes to the card, rather than straight to the host."""
        return True

    def open_and_close_shutter(self) -> float:
        """See the scene for ``exposure_s``; return when the shutter closed, a time of :func:`time.monotonic`.

        A look may take its time here, as at a page in a browser, which the camera that is emulated does not need: the last
        one begins so early that it ends about when the shutter closes.
        """
        start_s = time.monotonic()
        end_s = start_s + self.exposure_s
        if self.exposure_s > 0:
            self._photographs.open_shutter()
        look_s = time.monotonic() - start_s
        time.sleep(max(0.0, end_s - look_s - time.monotonic()))
        self._photographs.close_shutter()
        time.sleep(max(0.0, end_s - time.monotonic()))
        return end_s

    def develop(self) -> bytes:
        """Return the file of what was seen while the shutter was open."""
        return self._kept(self._photographs.develop)

    def _kept(self, new_photo: Callable[[], bytes]) -> bytes:
        """Return the file of one photo; a stale one repeats the photo before."""
        with self._lock:
            fresh = with_exif(new_photo(), self._exposure_of_photo())
            if self.faults.happens("stale") and self._last_photo is not None:
                fresh = self._last_photo
            self._last_photo = fresh
            self.photos_taken += 1
            return fresh

    def exposure(self) -> Exposure:
        """Return the exposure that the settings ask for."""
        raise NotImplementedError

    def _exposure_of_photo(self) -> Exposure:
        exposure = self.exposure()
        return replace(exposure, time_s=2 * exposure.time_s) if self.faults.happens("dial_turned") else exposure

    def live_view(self) -> bytes:
        """Return what the sensor sees now, without taking a photo."""
        return self._photographs()

    def store(self, data: bytes, *, kind: int = JPEG) -> StoredObject:
        """Put a file on the card: a JPEG, or one of Canon's RAW files."""
        with self._lock:
            handle = self._next_handle
            self._next_handle += 1
            stored = StoredObject(
                handle, PHOTO_FOLDER, f"IMG_{handle:05d}.{'JPG' if kind == JPEG else 'CR2'}", data, kind
            )
            self._objects[handle] = stored
            return stored

    def press_shutter_by_hand(self) -> None:
        """Take a photo that nobody on the wire asked for."""
        self.announce(self.store_stray())

    def store_stray(self) -> StoredObject:
        """Put a photo on the card that nobody on the wire asked for, without a word to the host."""
        return self.store(self._kept(self._photographs))

    def announce(self, *stored: StoredObject) -> None:
        """Tell the host, in one breath, that photos were added: it learns of all of them or of none."""
        self.tell(*((OBJECT_ADDED, (file.handle,)) for file in stored))

    # Operations of every PTP camera

    def _get_device_info(self, _request: Request) -> Reply:
        return Reply(data=self.describe().dataset())

    def _open_session(self, _request: Request) -> Reply:
        if self._session_open:
            return Reply(SESSION_ALREADY_OPEN)
        self._session_open = True
        return Reply()

    def _close_session(self, _request: Request) -> Reply:
        self.close()
        return Reply()

    def _get_storage_ids(self, _request: Request) -> Reply:
        return Reply(data=array_u32([STORAGE]))

    def _get_storage_info(self, request: Request) -> Reply:
        if request.parameter(0) != STORAGE:
            return Reply(INVALID_STORAGE)
        used_bytes = sum(len(stored.data) for stored in self._objects.values())
        free_bytes = 0 if self.faults.card_full else max(0, CARD_BYTES - used_bytes)
        free_photos = CARD_PHOTOS if free_bytes else 0
        return Reply(data=storage_info(capacity_bytes=CARD_BYTES, free_bytes=free_bytes, free_photos=free_photos))

    def _listed(self, request: Request) -> list[int]:
        kind, parent = request.parameter(1), request.parameter(2)
        with self._lock:
            return [
                stored.handle
                for stored in self._objects.values()
                if (not kind or stored.format == kind)
                and (parent == WHOLE_TREE or stored.parent == (0 if parent == ROOT_ONLY else parent))
            ]

    def _get_count(self, request: Request) -> Reply:
        return Reply(parameters=(len(self._listed(request)),))

    def _get_handles(self, request: Request) -> Reply:
        return Reply(data=array_u32(self._listed(request)))

    def _get_object_info(self, request: Request) -> Reply:
        stored = self._objects.get(request.parameter(0))
        return Reply(INVALID_HANDLE) if stored is None else Reply(data=stored.info(storage=STORAGE))

    def _get_object(self, request: Request) -> Reply:
        stored = self._objects.get(request.parameter(0))
        if stored is None:
            return Reply(INVALID_HANDLE)
        time.sleep(self.transfer_s)
        return Reply(data=self.cut_short(stored.data))

    def cut_short(self, data: bytes) -> bytes:
        """Return ``data``, or its first half when a download is due to be truncated."""
        return data[: len(data) // 2] if self.faults.happens("truncated") else data

    def _get_partial_object(self, request: Request) -> Reply:
        stored = self._objects.get(request.parameter(0))
        if stored is None:
            return Reply(INVALID_HANDLE)
        start, count = request.parameter(1), request.parameter(2)
        part = stored.data[start : start + count]
        time.sleep(self.transfer_s * len(part) / max(len(stored.data), 1))
        return Reply(parameters=(len(part),), data=part)

    def _delete_object(self, request: Request) -> Reply:
        with self._lock:
            gone = self._objects.pop(request.parameter(0), None)
        return Reply(INVALID_HANDLE) if gone is None else Reply()

    def forget(self, handle: int) -> None:
        """Drop a photo that the host has, as a body does with one that never was on its card."""
        with self._lock:
            self._objects.pop(handle, None)

    def set_property(self, code: int, value: int) -> None:
        """Take over a setting, unless the fault ``hidden_settings`` is due."""
        if not self.faults.happens("hidden_settings"):
            self.properties[code] = replace(self.properties[code], value=value)
