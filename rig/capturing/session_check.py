"""What a session that is to be resumed still holds: every photo read once more and held against the hash in its line."""

import hashlib
import os
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from recon.sessions.journal import JOURNAL_NAME, PhotoRecord, read_photos
from recon.sessions.session import Session
from rig.planning.steps import PhotoKey

# Hashing lets other threads run; beyond a few, the disk is the slower one.
MOST_THREADS = 8


@dataclass(frozen=True, slots=True)
class SessionCheck:
    """What was found.

    Attributes
    ----------
    whole
        Photos whose file has the hash of their line.
    gone
        Photos that have a line and no file.
    damaged
        Photos whose file is not what their line says, or whose line has no hash to tell.
    in_doubt
        Files without a line: a photo that was on its way to the disk when its program ended.
    """

    whole: frozenset[PhotoKey]
    gone: tuple[PhotoKey, ...] = ()
    damaged: tuple[PhotoKey, ...] = ()
    in_doubt: tuple[str, ...] = ()


def check_session(
    session: Session,
    *,
    on_photo: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> SessionCheck:
    """Read every photo that counts; ``on_photo`` hears after each how many of how many are read."""
    records = list(session.photos.items())
    whole, gone, damaged = set(), [], []
    with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1)) as pool:
        states = pool.map(lambda item: _state(session.folder, item[1]), records)
        for number, ((key, _), state) in enumerate(zip(records, states, strict=True), start=1):
            on_photo(number, len(records))
            if state == "whole":
                whole.add(key)
            elif state == "gone":
                gone.append(key)
            else:
                damaged.append(key)
    return SessionCheck(frozenset(whole), tuple(gone), tuple(damaged), _without_line(session.folder))


def _state(folder: Path, record: PhotoRecord) -> str:
    path = folder / record.file
    try:
        size = path.stat().st_size
    except OSError:
        return "gone"
    if record.sha256 is None or (record.bytes is not None and record.bytes != size):
        return "damaged"  # told without reading it
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return "damaged"
    return "whole" if digest == record.sha256 else "damaged"


def _without_line(folder: Path) -> tuple[str, ...]:
    named = {record.file for record in read_photos(folder / JOURNAL_NAME)}
    files = (path.relative_to(folder).as_posix() for path in (folder / "photos").rglob("*") if path.is_file())
    return tuple(sorted(set(files) - named))


def check_text(check: SessionCheck, *, planned: Collection[PhotoKey]) -> tuple[str, ...]:
    """Say in a few lines what was found and what follows from it."""
    whole = len(check.whole & set(planned))
    lines = [f"{whole} of {len(planned)} photos are whole, {len(planned) - whole} to be taken"]
    if check.gone:
        lines.append(f"missing, though the journal names them: {len(check.gone)}, such as {_name(check.gone[0])}")
    if check.damaged:
        lines.append(f"damaged, not what the journal says: {len(check.damaged)}, such as {_name(check.damaged[0])}")
    if check.in_doubt:
        lines.append(
            f"in doubt, on disk without a line in the journal: {len(check.in_doubt)}, such as {check.in_doubt[0]}"
        )
    return tuple(lines)


def _name(key: PhotoKey) -> str:
    return f"{key[0]} {key[1]} {key[2]}"
