"""Is a session sound? Every fault by file and reason (``recon validate``), or the first as an error (``recon run``)."""

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping
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
    bits: dict[str, int] = {}
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
        try:
            height, width, bits[record.file] = _size_and_depth(record.file, data)
        except SessionError as error:
            yield Fault(record.file, str(error))
            continue
        if (height, width) != (camera.rows, camera.columns):
            yield Fault(record.file, f"is {width} x {height} px, the manifest says {camera.columns} x {camera.rows}")
    yield from _wrong_depths(session, bits)
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


def _wrong_depths(session: Session, bits: Mapping[str, int]) -> Iterator[Fault]:
    """Yield a fault where photos of a sweep, or of its dark display, have other bits a sample than most beside them."""
    for capture_set in session.manifest.sets:
        sweeps = [
            [(capture_set.name, axis, number) for number in session.photo_numbers(capture_set, axis)]
            for axis in ("x", "y")
        ]
        black = (capture_set.name, "black", 0)
        # One black photo serves both sweeps; without it each stands alone.
        beside = "set" if black in session.photos else "sweep"
        for keys in [[black, *sweeps[0], *sweeps[1]]] if black in session.photos else sweeps:
            records = (session.photos.get(key) for key in keys)
            depths = {record.file: bits[record.file] for record in records if record and record.file in bits}
            usual = Counter(depths.values()).most_common(1)[0][0] if depths else 0
            odd = [file for file, depth in depths.items() if depth != usual]
            if odd:
                others = f" (and {len(odd) - 1} more)" if len(odd) > 1 else ""
                yield Fault(
                    f"{odd[0]}{others}",
                    f"{depths[odd[0]]} bits a sample, but most photos of the {beside} have {usual}; convert it to the same "
                    "depth, or take it again",
                )


def _size_and_depth(name: str, data: bytes) -> tuple[int, int, int]:
    """Return a photo's height, width and bits a sample, or raise ``SessionError`` with the reason why it has none."""
    if not data:
        raise SessionError("is empty; take it again")
    if is_raw(Path(name)):
        try:
            raw = decode_raw(data, Path(name), primary="white")
        except SessionError as error:
            raise SessionError(str(error).split(": ", 1)[-1]) from None
        return *raw.shape, 8 * raw.itemsize
    if data[:2] == b"\xff\xd8":
        try:
            height, width, _, _ = simplejpeg.decode_jpeg_header(data)
        except ValueError as error:
            raise SessionError(f"not a JPEG that can be read ({error})") from None
        if END_OF_IMAGE not in data[-TAIL_BYTES:]:
            raise SessionError("truncated: the JPEG has no end; take it again")
        return height, width, 8
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise SessionError("not a photo that can be decoded (JPEG, PNG, TIFF and raw files can)")
    if picture.dtype not in (np.uint8, np.uint16):
        raise SessionError(f"samples of type {picture.dtype}; 8 or 16 bits a sample are expected")
    return *picture.shape[:2], 8 * picture.itemsize
