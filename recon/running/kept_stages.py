"""What earlier runs left in a folder of results, known by hashes, so that only what changed is made again.

``OUT/kept.json`` holds for each stage the hash of all that it follows from (its key), what it found, and the hashes of the
files it wrote. A stage is kept where its key is the one asked for and its files are whole. The file can be deleted at any time.
"""

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from recon.sessions.disk import Disk, write_whole

KEPT_NAME = "kept.json"


class KeptStage(BaseModel):
    """One stage: the key of its inputs, the SHA-256 of its files by name, and its findings."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants")

    key: str
    files: dict[str, str]
    found: dict[str, Any]


class KeptBook(BaseModel):
    """All that ``kept.json`` holds, by stage."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants")

    schema_version: int = 1
    stages: dict[str, KeptStage] = {}


def kept_stage(out: Path, stage: str, key: str) -> KeptStage | None:
    """Return what is kept of a stage, or None where its inputs were others or a file of it is not what it wrote."""
    kept = _book(out).stages.get(stage)
    if kept is None or kept.key != key:
        return None
    try:
        return kept if all(file_hash(out / name) == value for name, value in kept.files.items()) else None
    except OSError:
        return None


def keep_stage(
    out: Path, stage: str, key: str, *, files: Sequence[str], found: dict[str, Any], threads: int = 1
) -> None:
    """Keep a stage in place of what was kept of it before; so many ``threads`` read its files. Raises ``OSError``."""
    with ThreadPoolExecutor(threads) as pool:
        hashes = dict(zip(files, pool.map(file_hash, [out / name for name in files]), strict=True))
    _write(out, {**_book(out).stages, stage: KeptStage(key=key, files=hashes, found=found)})


def keep_rewritten(out: Path, name: str) -> None:
    """Take note that one file was written again from the same results; raises ``OSError``."""
    stages = {
        stage: kept.model_copy(update={"files": {**kept.files, name: file_hash(out / name)}})
        if name in kept.files
        else kept
        for stage, kept in _book(out).stages.items()
    }
    if stages:
        _write(out, stages)


def forget_stage(out: Path, stage: str) -> None:
    """Keep no more of a stage, before its files are written again: a run that is killed in between leaves no mixture."""
    stages = dict(_book(out).stages)
    if stages.pop(stage, None) is not None:
        _write(out, stages)


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _book(out: Path) -> KeptBook:
    try:
        return KeptBook.model_validate_json((out / KEPT_NAME).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValidationError):
        return KeptBook()


def _write(out: Path, stages: dict[str, KeptStage]) -> None:
    # Not flushed: what a power cut takes is made again.
    write_whole(out / KEPT_NAME, KeptBook(stages=stages).model_dump_json(indent=1).encode(), disk=Disk(durable=False))
