"""The append-only journal of a session: one JSON object a line, flushed to disk before anyone relies on it.

What the journal says is the truth. A last line without its line feed is what a power cut leaves: it is
dropped on reading.
"""

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

from recon.errors import SessionError

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
    """Append lines to a journal; each is on disk when the call returns, or ``durable`` is False."""

    def __init__(self, path: Path, *, durable: bool = True) -> None:
        _cut_torn_line(path)
        self._durable = durable
        self._file = path.open("ab")

    def append(self, event: str, **fields: object) -> None:
        """Write one line and flush it to the disk."""
        line = json.dumps({"event": event, "time": now_text(), **fields}, allow_nan=False)
        self._file.write(line.encode() + b"\n")
        self._file.flush()
        if self._durable:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file; safe to call twice."""
        self._file.close()

    def __enter__(self) -> "JournalWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _cut_torn_line(path: Path) -> None:
    """Drop a half-written last line, so that the next line starts on a line of its own."""
    if not path.exists():
        return
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole < len(data):
        with path.open("r+b") as file:
            file.truncate(whole)
            os.fsync(file.fileno())


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the journal's whole lines in order; a torn last line is left out."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise SessionError(f"{path}: no journal; is this the folder of a session?") from None
    *lines, _torn = data.split(b"\n")
    for number, line in enumerate(lines, start=1):
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
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise SessionError(f"{path}, entry {number}: {where}: {first['msg']}") from None
