"""A session on disk: a folder that a person can read.

::

    SESSION/manifest.json            what the photos mean (``manifest.py``), written once
    SESSION/journal.jsonl            what happened, one line an event, append only (``journal.py``)
    SESSION/photos/SET/AXIS/0000.jpg the sweeps, as the camera gave them
    SESSION/photos/SET/white.jpg     whole display lit; likewise black.jpg
    SESSION/correspondence/          decoded sweeps, which can be made again (``correspondence_store.py``)
    SESSION/truth.npz                only in simulations, read by nothing but evaluation

A photo is written under a temporary name, flushed and renamed before its journal line is written, so that a
line never names a photo that is not whole. The manifest comes last when a session is begun: a folder that has one has
all that a session needs.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any

from pydantic import ValidationError

from recon.bad_value import first_fault
from recon.errors import SessionError
from recon.patterns.swept_range import narrowed
from recon.sessions.disk import PART_SUFFIX, Disk, make_folders, write_fault, write_whole
from recon.sessions.journal import JOURNAL_NAME, JournalWriter, PhotoRecord, SweepRange, now_text, read_state
from recon.sessions.manifest import SCHEMA_VERSION, Axis, CaptureSet, Manifest

MANIFEST_NAME = "manifest.json"
TRUTH_NAME = "truth.npz"
DISK = Disk()


def photo_path(set_name: str, sweep: str, index: int, suffix: str, *, attempt: int = 1) -> str:
    """Return a photo's place inside the session, with forward slashes; a second attempt at a sweep has its own folder."""
    if sweep in ("x", "y"):
        folder = sweep if attempt == 1 else f"{sweep}-{attempt}"
        return f"photos/{set_name}/{folder}/{index:04d}{suffix}"
    numbered = "" if sweep in ("white", "black") else f"_{index:04d}"
    return f"photos/{set_name}/{sweep}{numbered}{suffix}"


def check_inside(relative: str, *, what: str) -> None:
    """Refuse a path that is absolute or climbs out of the session's folder."""
    path = PurePosixPath(relative)
    if path.is_absolute() or ".." in path.parts or "\\" in relative or ":" in relative:
        raise SessionError(f"{what}: {relative!r} must be a path inside the session, without '..'")


def parse_manifest(text: str, *, source: str) -> Manifest:
    """Read a manifest, or say in one sentence what is wrong with its first bad field."""
    try:
        data = json.loads(text)
    except ValueError as error:
        raise SessionError(f"{source}: not JSON ({error})") from None
    version = data.get("schema_version") if isinstance(data, dict) else None
    if version != SCHEMA_VERSION:
        raise SessionError(
            f"{source}: schema_version is {version!r}, this program reads {SCHEMA_VERSION}; "
            "use the version of the program that wrote the session, or correct the field"
        )
    try:
        manifest = Manifest.model_validate(data)
    except ValidationError as error:
        raise SessionError(f"{source}: {first_fault(error, whole='manifest')}") from None
    if manifest.mask is not None:
        check_inside(manifest.mask, what=f"{source}: mask")
    return manifest


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """A saved session, opened for reading: its manifest and the photos that the journal vouches for.

    The manifest's sweeps are those that were swept: where the journal narrows one, its pattern begins at stripe ``first_index``
    of the pattern on disk. Photos keep the numbers of the pattern on disk.
    """

    folder: Path
    manifest: Manifest
    photos: Mapping[tuple[str, str, int], PhotoRecord]
    ranges: Mapping[tuple[str, str], SweepRange] = field(default_factory=dict)
    rejections: Mapping[tuple[str, str], int] = field(default_factory=dict)

    def photo_numbers(self, capture_set: CaptureSet, axis: Axis) -> range:
        """Return the numbers of a sweep's photos, in the order of its stripes."""
        found = self.ranges.get((capture_set.name, axis))
        first = found.first_index if found else 0
        return range(first, first + capture_set.sweep(axis).pattern.count)

    def photo_file(self, set_name: str, sweep: str, index: int = 0) -> Path:
        """Return the path of a photo, or say which one is missing."""
        record = self.photos.get((set_name, sweep, index))
        if record is None:
            raise SessionError(
                f"{self.folder}: the journal has no photo {index} of {set_name}/{sweep}; "
                "resume the capture or take the photo again"
            )
        return self.folder / record.file


def open_session(folder: Path) -> Session:
    """Open a session for reading; every fault found on the way is a one-sentence ``SessionError``."""
    if not folder.is_dir():
        raise SessionError(f"{folder}: no such folder; give the folder of a session")
    source = folder / MANIFEST_NAME
    try:
        text = source.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise SessionError(f"{folder}: no {MANIFEST_NAME} here; is this the folder of a session?") from None
    except (OSError, UnicodeDecodeError) as error:
        raise SessionError(f"{source}: cannot be read ({error})") from None
    manifest = parse_manifest(text, source=str(source))
    journal = folder / JOURNAL_NAME
    state = read_state(journal)
    for record in state.photos.values():
        check_inside(record.file, what=f"{journal}: file")
    swept = narrowed(manifest, state.ranges, source=str(journal))
    return Session(folder, swept, state.photos, ranges=state.ranges, rejections=state.rejections)


class SessionWriter:
    """Writes a session so that nothing it acknowledged can be lost.

    Every ``OSError`` on the way becomes a ``SessionError``. ``disk`` is what it writes with, :data:`DISK` where none is given.
    """

    def __init__(self, folder: Path, manifest: Manifest, journal: JournalWriter, *, disk: Disk) -> None:
        self.folder = folder
        self.manifest = manifest
        self.journal = journal
        self._disk = disk
        self._ready_folders = {folder}
        self._rejections: Counter[tuple[str, str]] = Counter()

    @classmethod
    def create(cls, folder: Path, manifest: Manifest, *, disk: Disk | None = None) -> "SessionWriter":
        """Start a new session in a folder that is absent or empty, or holds a beginning that never became a session."""
        disk = disk or DISK
        try:
            make_folders(folder, disk=disk)
            if not _holds_nothing(folder):
                raise SessionError(f"{folder}: not empty; choose a new folder for the session")
            journal = JournalWriter(folder / JOURNAL_NAME, disk=disk)
            write_whole(folder / MANIFEST_NAME, (manifest.model_dump_json(indent=2) + "\n").encode(), disk=disk)
            return cls(folder, manifest, journal, disk=disk)
        except OSError as error:
            raise SessionError(write_fault(folder, error)) from error

    @classmethod
    def reopen(cls, folder: Path, *, disk: Disk | None = None) -> "SessionWriter":
        """Continue a session that was interrupted; half-written files, which no line names, are removed."""
        disk = disk or DISK
        session = open_session(folder)
        try:
            for part in folder.rglob(f"*{PART_SUFFIX}"):
                disk.remove(part)
            make_folders(folder, disk=disk)
        except OSError as error:
            raise SessionError(write_fault(folder, error)) from error
        writer = cls(folder, session.manifest, JournalWriter(folder / JOURNAL_NAME, disk=disk), disk=disk)
        writer._rejections.update(session.rejections)
        return writer

    def save_photo(
        self,
        data: bytes,
        *,
        set_name: str,
        sweep: str,
        index: int = 0,
        suffix: str = ".jpg",
        place_px: float | None = None,
        device: dict[str, Any] | None = None,
    ) -> PhotoRecord:
        """Write a photo, then its journal line; both are on disk when this returns."""
        record = PhotoRecord(
            set=set_name,
            sweep=sweep,
            index=index,
            place_px=place_px,
            file=photo_path(set_name, sweep, index, suffix, attempt=1 + self._rejections[set_name, sweep]),
            sha256=hashlib.sha256(data).hexdigest(),
            bytes=len(data),
            time=now_text(),
            device=device or {},
        )
        path = self.folder / record.file
        try:
            self._make_ready(path.parent)
            write_whole(path, data, disk=self._disk)
        except OSError as error:
            raise SessionError(write_fault(path, error)) from error
        self.journal.append("photo", **record.model_dump())
        return record

    def reject_sweep(self, set_name: str, sweep: str, *, reason: str) -> None:
        """Void every photo of a sweep so far; its files stay, and new ones go to a folder of their own."""
        self.journal.append("sweep_rejected", set=set_name, sweep=sweep, reason=reason)
        self._rejections[set_name, sweep] += 1

    def _make_ready(self, folder: Path) -> None:
        """Make a folder of photos, whose name lasts; one that is there may have been made just before a power cut."""
        if folder in self._ready_folders:
            return
        self._make_ready(folder.parent)
        self._disk.make_folder(folder)
        self._disk.flush_folder(folder.parent)
        self._ready_folders.add(folder)

    def close(self) -> None:
        """Close the journal; safe to call twice."""
        self.journal.close()

    def __enter__(self) -> "SessionWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _holds_nothing(folder: Path) -> bool:
    """Tell whether a folder is empty, but for what :meth:`SessionWriter.create` leaves when it is cut short."""
    beginnings = {JOURNAL_NAME, MANIFEST_NAME + PART_SUFFIX}
    return all(
        path.name in beginnings and not (path.name == JOURNAL_NAME and path.stat().st_size) for path in folder.iterdir()
    )
