"""Decoded sweeps kept beside the photos, so that no sweep is decoded twice.

``SESSION/correspondence/SET-AXIS-METHOD-KEY.npz`` holds one :class:`~recon.sweeps.correspondence.SweepResult`. The key is a
hash of all that the result follows from: the photos' own hashes in the journal, the pattern, what display and camera
are, the method, and the program's text and libraries. A file whose key is not the one asked for is never looked at, so
nothing has to be kept up to date, and the folder can be deleted at any time.
"""

import hashlib
import json
import logging
import os
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from recon.calibration.response_record import RESPONSE_NAME
from recon.memory import give_back_free_memory
from recon.method import Method
from recon.metrics import PhotoQuality, SampleCurve
from recon.program import program_hash
from recon.sessions.disk import PART_SUFFIX, Disk, make_folders
from recon.sessions.manifest import Axis, CaptureSet
from recon.sessions.session import Session
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.decode_pattern import decode_pattern
from recon.sweeps.noise import NoiseModel

STORE_NAME = "correspondence"
KEY_DIGITS = 20
LOG = logging.getLogger(__name__)
ARRAYS = ("place_px", "sd_px", "status")
SECOND_ARRAYS = ("second_px", "second_sd_px")


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
    return session.folder / STORE_NAME / f"{capture_set.name}-{axis}-{method}-{key[:KEY_DIGITS]}.npz"


def load_stored(session: Session, capture_set: CaptureSet, axis: Axis, *, method: Method) -> SweepResult | None:
    """Return the kept result of a sweep, or None where there is none that is valid and whole."""
    path = store_path(session, capture_set, axis, method=method)
    if path is None or not path.is_file():
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            rest = json.loads(bytes(stored["rest"]))
            place_px, sd_px, status = (stored[name] for name in ARRAYS)
            second_px, second_sd_px = (stored.get(name) for name in SECOND_ARRAYS)
        return SweepResult(
            place_px=place_px,
            sd_px=sd_px,
            status=status,
            noise=NoiseModel(**rest["noise"]),
            misfit=rest["misfit"],
            photos=tuple(PhotoQuality.model_validate(one) for one in rest["photos"]),
            curves=tuple(SampleCurve.model_validate(one) for one in rest["curves"]),
            second_px=second_px,
            second_sd_px=second_sd_px,
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
    named = {name: getattr(result, name) for name in (*ARRAYS, *SECOND_ARRAYS)}
    arrays = {name: array for name, array in named.items() if array is not None}
    make_folders(path.parent, disk=Disk(durable=False))
    # Each process a name of its own: two may decode the same sweep. Not flushed: a power cut takes what can be decoded again.
    temporary = path.with_name(f"{path.name}.{os.getpid()}{PART_SUFFIX}")
    try:
        with temporary.open("wb") as file:
            np.savez(file, rest=np.frombuffer(json.dumps(rest).encode(), dtype=np.uint8), **arrays)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    _forget_others(path)
    return path


def _forget_others(path: Path) -> None:
    """Remove the results of the same sweep that photos or programs of the past have left."""
    for other in path.parent.glob(path.name[: -len(".npz") - KEY_DIGITS] + "?" * KEY_DIGITS + ".npz"):
        if other != path:
            other.unlink(missing_ok=True)


def stored_or_decoded(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    *,
    method: Method,
    force: bool = False,
    on_photo: Callable[[], None] = lambda: None,
    on_kept: Callable[[str], None] = lambda _: None,
) -> SweepResult:
    """Return the result of a sweep: the kept one where it is valid (``on_kept`` hears of it), else decoded and kept."""
    found = None if force else load_stored(session, capture_set, axis, method=method)
    if found is not None:
        for _ in session.photo_numbers(capture_set, axis):
            on_photo()
        on_kept(f"{capture_set.name}/{axis}")
        return found
    result = decode_pattern(session, capture_set, axis, method=method, on_photo=on_photo)
    give_back_free_memory()
    try:
        save_stored(session, capture_set, axis, result, method=method)
    except OSError as error:  # a session on a medium that cannot be written, or that is full
        LOG.warning("%s/%s cannot be kept for the next run (%s)", capture_set.name, axis, error.strerror)
    return result
