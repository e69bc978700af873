"""Decoded sweeps kept beside the photos, so that no sweep is decoded twice.

``SESSION/correspondence/SET-AXIS-METHOD-KEY.npz`` holds one :class:`~recon.sweeps.correspondence.SweepResult`. The key is a
hash of all that the result follows from: the photos' own hashes in the journal, the pattern, what display and camera
are, the method, and the program's text and libraries. A file whose key is not the one asked for is never looked at, so
nothing has to be kept up to date, and the folder can be deleted at any time.
"""

import hashlib
import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from recon.calibration.response_record import RESPONSE_NAME
from recon.metrics import PhotoQuality, SampleCurve
from recon.program import program_hash
from recon.sessions.disk import Disk, make_folders, write_whole
from recon.sessions.manifest import Axis, CaptureSet
from recon.sessions.session import Session
from recon.sweeps.correspondence import Method, SweepResult
from recon.sweeps.decode_pattern import decode_pattern
from recon.sweeps.noise import NoiseModel

STORE_NAME = "correspondence"
ARRAYS = ("place_px", "sd_px", "status")


def store_key(session: Session, capture_set: CaptureSet, axis: Axis, *, method: Method) -> str | None:
    """Return the hash of all that a sweep's result follows from; None where the journal lacks a photo or its hash."""
    numbers = [(axis, number) for number in session.photo_numbers(capture_set, axis)]
    records = [session.photos.get((capture_set.name, sweep, number)) for sweep, number in numbers]
    hashes = [record.sha256 if record else None for record in records]
    if None in hashes:
        return None
    black = session.photos.get((capture_set.name, "black", 0))
    if black is not None and black.sha256 is None:
        return None
    camera = session.manifest.camera
    response = session.folder / RESPONSE_NAME
    parts = {
        "program": program_hash(),
        "method": method,
        "axis": axis,
        "set": capture_set.name,
        "pattern": capture_set.sweep(axis).pattern.model_dump(),
        "display": session.manifest.display.model_dump(),
        "camera": [camera.rows, camera.columns],
        "photos": hashes,
        "black": black.sha256 if black else None,
        "response": hashlib.sha256(response.read_bytes()).hexdigest() if response.is_file() else None,
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def store_path(session: Session, capture_set: CaptureSet, axis: Axis, *, method: Method) -> Path | None:
    """Return where the result of a sweep is kept; None where it cannot be kept."""
    key = store_key(session, capture_set, axis, method=method)
    if key is None:
        return None
    return session.folder / STORE_NAME / f"{capture_set.name}-{axis}-{method}-{key[:20]}.npz"


def load_stored(session: Session, capture_set: CaptureSet, axis: Axis, *, method: Method) -> SweepResult | None:
    """Return the kept result of a sweep, or None where there is none that is valid and whole."""
    path = store_path(session, capture_set, axis, method=method)
    if path is None or not path.is_file():
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            rest = json.loads(bytes(stored["rest"]))
            place_px, sd_px, status = (stored[name] for name in ARRAYS)
        return SweepResult(
            place_px=place_px,
            sd_px=sd_px,
            status=status,
            noise=NoiseModel(**rest["noise"]),
            misfit=rest["misfit"],
            photos=tuple(PhotoQuality.model_validate(one) for one in rest["photos"]),
            curves=tuple(SampleCurve.model_validate(one) for one in rest["curves"]),
        )
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
        return None  # damaged: the sweep is decoded from its photos, as if there were nothing here


def save_stored(
    session: Session, capture_set: CaptureSet, axis: Axis, result: SweepResult, *, method: Method
) -> Path | None:
    """Keep the result of a sweep; return its file, or None where the journal holds no hashes to know it by."""
    path = store_path(session, capture_set, axis, method=method)
    if path is None:
        return None
    rest = {
        "noise": asdict(result.noise),
        "misfit": result.misfit,
        "photos": [photo.model_dump() for photo in result.photos],
        "curves": [curve.model_dump() for curve in result.curves],
    }
    arrays = {name: getattr(result, name) for name in ARRAYS}
    packed = io.BytesIO()
    np.savez(packed, rest=np.frombuffer(json.dumps(rest).encode(), dtype=np.uint8), **arrays)
    # Not flushed to the disk one by one: what a power cut takes can be decoded again.
    disk = Disk(durable=False)
    make_folders(path.parent, disk=disk)
    write_whole(path, packed.getvalue(), disk=disk)
    return path


def stored_or_decoded(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    *,
    method: Method,
    on_photo: Callable[[], None] = lambda: None,
) -> SweepResult:
    """Return the result of a sweep: the kept one where it is valid, else decoded from its photos."""
    found = load_stored(session, capture_set, axis, method=method)
    if found is None:
        return decode_pattern(session, capture_set, axis, method=method, on_photo=on_photo)
    for _ in session.photo_numbers(capture_set, axis):
        on_photo()
    return found
