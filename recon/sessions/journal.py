"""The append-only journal of a session: one JSON object a line, flushed to disk before anyone relies on it.

What the journal says is the truth. A last line without its line feed, or with NUL bytes where its end did not reach the
disk, is what a power cut leaves: it is dropped on reading.
"""

import contextlib
import json
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from recon.bad_value import first_fault
from recon.errors import SessionError
from recon.sessions.disk import Disk, write_fault

JOURNAL_NAME = "journal.jsonl"


class PhotoRecord(BaseModel):
    """The journal line of one photo. ``sweep`` is ``x``, ``y`` or a single photo's name (``white``, ``black``, ...)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    set: str
    sweep: str
    index: int = 0
    place_px: float | None = None
    file: str
    sha256: str | None = None
    bytes: int | None = None
    time: str = ""
    device: dict[str, Any] = {}


class SweepRange(BaseModel):
    """The journal line that narrows one sweep to the part of the display that is seen, first and last stripe included."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    set: str
    axis: Literal["x", "y"]
    first_index: Annotated[int, Field(ge=0)]
    last_index: int
    time: str = ""


class SweepRejected(BaseModel):
    """The journal line that voids every photo of one sweep before it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    set: str
    sweep: str
    reason: str = ""
    time: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class JournalState:
    """What a journal leaves in force: photos by (set, sweep, index), ranges by (set, axis), rejections by (set, sweep)."""

    photos: dict[tuple[str, str, int], PhotoRecord] = field(default_factory=dict)
    ranges: dict[tuple[str, str], SweepRange] = field(default_factory=dict)
    rejections: Counter[tuple[str, str]] = field(default_factory=Counter)


def now_text() -> str:
    """Return the present time as ISO 8601 in UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


class JournalWriter:
    """Append lines to a journal; each is on disk when the call returns, unless ``disk`` is not durable.

    Raises
    ------
    SessionError
        When a line cannot be written. It is taken back, so that no half of a line stands before a whole one. After a
        flush that failed nothing is appended any more: what the disk then holds is not known until it is read again.
    """

    def __init__(self, path: Path, *, disk: Disk) -> None:
        self._path = path
        self._disk = disk
        self._fault = ""
        self._file: int | None = None
        try:
            self._file = disk.open_to_append(path)
            self._cut_torn_line(self._file)
            # Also after a kill, which cuts nothing: lines that were written and not flushed are relied on from here.
            disk.flush(self._file)
            disk.flush_folder(path.parent)
        except OSError as error:
            self.close()
            raise SessionError(write_fault(path, error)) from error

    def append(self, event: str, **fields: object) -> None:
        """Write one line and flush it to the disk."""
        if self._fault or self._file is None:
            raise SessionError(self._fault or f"{self._path}: is closed; resume the capture")
        entry = json.dumps({"event": event, "time": now_text(), **fields}, allow_nan=False)
        line = entry.encode() + b"\n"
        written = False
        try:
            if os.fstat(self._file).st_size != self._length:  # Ctrl-C came in the middle of the line before
                self._cut_torn_line(self._file)
            self._disk.write(self._file, line)
            written = True
            self._disk.flush(self._file)
        except OSError as error:
            fault = write_fault(self._path, error)
            if written:
                self._fault = fault
            self._take_back(self._file)
            raise SessionError(fault) from error
        self._length += len(line)

    def _cut_torn_line(self, file: int) -> None:
        self._length = _whole_length(self._path.read_bytes())
        self._disk.truncate(file, self._length)

    def _take_back(self, file: int) -> None:
        try:
            self._disk.truncate(file, self._length)
        except OSError as error:
            self._fault = write_fault(self._path, error)

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file is not None:
            with contextlib.suppress(OSError):  # every line that counts was flushed
                self._disk.close(self._file)
            self._file = None

    def __enter__(self) -> "JournalWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _whole_length(data: bytes) -> int:
    """Return how many bytes of a journal are whole lines; a torn line can only be the last."""
    end = data.rfind(b"\n") + 1
    last = data.rfind(b"\n", 0, max(end - 1, 0)) + 1
    # JSON writes NUL as \\u0000: a NUL byte is a page of the file that never reached the disk.
    return last if b"\0" in data[last:end] else end


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the journal's whole lines in order; a torn last line is left out."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise SessionError(f"{path}: no journal; is this the folder of a session?") from None
    for number, line in enumerate(data[: _whole_length(data)].split(b"\n"), start=1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
        except ValueError:
            raise SessionError(f"{path}, line {number}: not JSON; restore the line or remove it") from None
        if not isinstance(entry, dict) or "event" not in entry:
            raise SessionError(f'{path}, line {number}: needs an object with an "event"')
        yield entry


def read_photos(path: Path) -> Iterator[PhotoRecord]:
    """Yield the journal's photos in order; a photo that was taken again comes again."""
    for record in _records(path):
        if isinstance(record, PhotoRecord):
            yield record


def read_state(path: Path) -> JournalState:
    """Return what is in force at the end of the journal: the last line counts, and a rejected sweep has no photos."""
    state = JournalState()
    for record in _records(path):
        match record:
            case PhotoRecord():
                state.photos[record.set, record.sweep, record.index] = record
            case SweepRange():
                state.ranges[record.set, record.axis] = record
            case SweepRejected():
                state.rejections[record.set, record.sweep] += 1
                for key in [key for key in state.photos if key[:2] == (record.set, record.sweep)]:
                    del state.photos[key]
    return state


RECORDS: dict[str, type[PhotoRecord | SweepRange | SweepRejected]] = {
    "photo": PhotoRecord,
    "sweep_range": SweepRange,
    "sweep_rejected": SweepRejected,
}


def _records(path: Path) -> Iterator[PhotoRecord | SweepRange | SweepRejected]:
    """Yield the lines that a reader of the session needs, checked; others are for people."""
    for number, entry in enumerate(read_journal(path), start=1):
        record = RECORDS.get(entry["event"])
        if record is None:
            continue
        try:
            yield record.model_validate({k: v for k, v in entry.items() if k != "event"})
        except ValidationError as error:
            raise SessionError(f"{path}, entry {number}: {first_fault(error, whole='entry')}") from None
