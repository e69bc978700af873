"""Is a session sound? Every fault by file and reason (``recon validate``), or the first as an error (``recon run``)."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import simplejpeg

from recon.errors import SessionError
from recon.patterns.pattern_frames import place_of_photo
from recon.sessions.manifest import Axis, CaptureSet
from recon.sessions.photos import read_grey
from recon.sessions.raw_photos import decode_raw, is_raw
from recon.sessions.session import Session

# A truncated JPEG lacks its end-of-image marker (ITU-T T.81, B.1.1.3).
END_OF_IMAGE = b"\xff\xd9"
# Some cameras and tools append a little padding behind the marker.
TAIL_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong with a session; a warning does not stop a reconstruction."""

    where: str
    reason: str
    is_warning: bool = False

    def __str__(self) -> str:
        return f"{self.where}: {self.reason}"


def check_whole(session: Session) -> None:
    """Raise ``SessionError`` for the first fault that a reconstruction would trip over; no photo is decoded."""
    for fault in missing_photos(session):
        raise SessionError(str(fault))


def missing_photos(session: Session) -> Iterator[Fault]:
    """Yield a fault for each hole in a sweep and for each photo that the journal names and the disk lacks."""
    for capture_set in session.manifest.sets:
        yield from _missing_of_set(session, capture_set)
    known = {
        (one.name, sweep.axis): session.photo_numbers(one, sweep.axis)
        for one in session.manifest.sets
        for sweep in one.sweeps
    }
    for (set_name, sweep, index), record in session.photos.items():
        if not (session.folder / record.file).is_file():
            yield Fault(record.file, "the journal names this photo, but it is missing; restore it or take it again")
        if sweep not in ("x", "y"):
            continue
        if (set_name, sweep) not in known:
            yield Fault(record.file, f"the manifest has no sweep {set_name}/{sweep}", is_warning=True)
        elif index not in known[set_name, sweep]:  # type: ignore[index]  # x or y
            yield Fault(record.file, f"number {index} lies outside the sweep that was planned", is_warning=True)


def _missing_of_set(session: Session, capture_set: CaptureSet) -> Iterator[Fault]:
    for sweep in capture_set.sweeps:
        name = f"{session.folder}: sweep {capture_set.name}/{sweep.axis}"
        numbers = session.photo_numbers(capture_set, sweep.axis)
        holes = [n for n in numbers if (capture_set.name, sweep.axis, n) not in session.photos]
        if len(holes) == sweep.pattern.count:
            yield Fault(name, "no photo at all; resume the capture")
        elif holes:
            others = f" and {len(holes) - 1} more" if len(holes) > 1 else ""
            yield Fault(name, f"photo {holes[0]}{others} of {sweep.pattern.count} missing; resume the capture")


def faults(session: Session) -> Iterator[Fault]:
    """Yield every fault of a session: missing, altered, truncated, or of the wrong size or place."""
    yield from missing_photos(session)
    yield from _wrong_places(session)
    camera = session.manifest.camera
    seen: dict[str, str] = {}
    for record in session.photos.values():
        path = session.folder / record.file
        if not path.is_file():
            continue
        try:
            data = path.read_bytes()
        except OSError as error:
            yield Fault(record.file, f"cannot be read ({error.strerror})")
            continue
        digest = hashlib.sha256(data).hexdigest()
        if record.sha256 is None:
            yield Fault(record.file, "the journal holds no sha256; damage cannot be noticed", is_warning=True)
        elif digest != record.sha256:
            yield Fault(record.file, "its sha256 is not the journal's; the file was changed or damaged")
        if digest in seen:
            yield Fault(
                record.file, f"the same bytes as {seen[digest]}; the camera returned an old photo", is_warning=True
            )
        seen[digest] = record.file
        yield from _picture_faults(record.file, data, rows=camera.rows, cols=camera.columns)
    if session.manifest.mask is not None:
        try:
            read_grey(session.folder / session.manifest.mask, rows=camera.rows, cols=camera.columns)
        except SessionError as error:
            yield Fault(session.manifest.mask, str(error).split(": ", 1)[-1])


def _wrong_places(session: Session) -> Iterator[Fault]:
    for record in session.photos.values():
        if record.sweep not in ("x", "y") or record.place_px is None:
            continue
        names = {one.name for one in session.manifest.sets}
        if record.set not in names:
            continue
        axis: Axis = "x" if record.sweep == "x" else "y"
        capture_set = session.manifest.set_named(record.set)
        pattern = capture_set.sweep(axis).pattern
        place = record.index - session.photo_numbers(capture_set, axis).start
        expected = place_of_photo(pattern, place)
        if expected is None:
            continue
        if not np.isclose(record.place_px, expected, rtol=0, atol=1e-6):
            yield Fault(
                record.file, f"the journal puts its stripe at {record.place_px} px, the manifest at {expected} px"
            )


def _picture_faults(name: str, data: bytes, *, rows: int, cols: int) -> Iterator[Fault]:
    if not data:
        yield Fault(name, "is empty; take it again")
        return
    if is_raw(Path(name)):
        try:
            height, width = decode_raw(data, Path(name), primary="white").shape
        except SessionError as error:
            yield Fault(name, str(error).split(": ", 1)[-1])
            return
    elif data[:2] == b"\xff\xd8":
        try:
            height, width, _, _ = simplejpeg.decode_jpeg_header(data)
        except ValueError as error:
            yield Fault(name, f"not a JPEG that can be read ({error})")
            return
        if END_OF_IMAGE not in data[-TAIL_BYTES:]:
            yield Fault(name, "truncated: the JPEG has no end; take it again")
    else:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if picture is None:
            yield Fault(name, "not a photo that can be decoded (JPEG, PNG, TIFF and raw files can)")
            return
        height, width = picture.shape[:2]
    if (height, width) != (rows, cols):
        yield Fault(name, f"is {width} x {height} px, the manifest says {cols} x {rows}")
