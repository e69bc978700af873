"""A sweep that was decoded during the capture is not decoded again, and nothing stale is ever used."""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from session_example import write_session

from recon.run import decode_session
from recon.running.settings import Settings
from recon.sessions.session import Session, open_session
from recon.sweeps import correspondence_store
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.correspondence_store import load_stored, save_stored, store_path, stored_or_decoded
from recon.sweeps.decode_pattern import decode_pattern


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A tiny session whose journal holds the hash of every photo."""
    folder = write_session(tmp_path / "session")
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    for line in lines:
        line["sha256"] = hashlib.sha256((folder / line["file"]).read_bytes()).hexdigest()
    (folder / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder


def first_sweep(folder: Path) -> tuple[Session, Any]:
    session = open_session(folder)
    return session, session.manifest.set_named("pos0_air")


def keep(folder: Path) -> tuple[SweepResult, Path]:
    session, one = first_sweep(folder)
    result = decode_pattern(session, one, "x", method="full")
    path = save_stored(session, one, "x", result, method="full")
    assert path is not None
    return result, path


def assert_same(first: SweepResult, second: SweepResult) -> None:
    for field in dataclasses.fields(SweepResult):
        ours, theirs = getattr(first, field.name), getattr(second, field.name)
        if isinstance(ours, np.ndarray):
            assert ours.dtype == theirs.dtype
            np.testing.assert_array_equal(ours, theirs)
        elif dataclasses.is_dataclass(ours):
            assert dataclasses.asdict(ours) == dataclasses.asdict(theirs)
        else:
            assert ours == theirs, field.name


def test_every_field_of_a_result_comes_back_as_it_was(folder: Path) -> None:
    result, _ = keep(folder)
    session, one = first_sweep(folder)
    found = load_stored(session, one, "x", method="full")
    assert found is not None
    assert_same(found, result)


def test_a_kept_sweep_is_not_decoded_again_and_the_others_are(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result, _ = keep(folder)
    decoded = []

    def counting(session: Session, one: Any, axis: Any, **rest: Any) -> SweepResult:
        decoded.append((one.name, axis))
        return decode_pattern(session, one, axis, **rest)

    monkeypatch.setattr(correspondence_store, "decode_pattern", counting)
    sweeps = decode_session(open_session(folder), Settings(threads=1))
    assert len(sweeps) == 8
    assert len(decoded) == 7
    assert ("pos0_air", "x") not in decoded
    assert_same(sweeps["pos0_air", "x"], result)


def test_a_photo_taken_again_makes_the_kept_sweep_another_one(folder: Path) -> None:
    keep(folder)
    with (folder / "journal.jsonl").open("a") as journal:
        line = {"event": "photo", "set": "pos0_air", "sweep": "x", "index": 2, "sha256": "0" * 64}
        journal.write(json.dumps({**line, "file": "photos/pos0_air/x/0002.jpg"}) + "\n")
    session, one = first_sweep(folder)
    assert load_stored(session, one, "x", method="full") is None


def test_a_narrowed_sweep_a_black_photo_and_the_other_method_are_other_sweeps(folder: Path) -> None:
    session, one = first_sweep(folder)
    paths = {store_path(session, one, "x", method="full"), store_path(session, one, "x", method="paper")}
    with (folder / "journal.jsonl").open("a") as journal:
        journal.write('{"event": "sweep_range", "set": "pos0_air", "axis": "x", "first_index": 0, "last_index": 3}\n')
    paths.add(store_path(*first_sweep(folder), "x", method="full"))
    with (folder / "journal.jsonl").open("a") as journal:
        black = {"event": "photo", "set": "pos0_air", "sweep": "black", "file": "black.jpg", "sha256": "1" * 64}
        journal.write(json.dumps(black) + "\n")
    paths.add(store_path(*first_sweep(folder), "x", method="full"))
    assert len(paths) == 4
    assert None not in paths


def test_a_change_of_the_program_makes_every_kept_sweep_another_one(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep(folder)
    monkeypatch.setattr(correspondence_store, "program_hash", lambda: "another program")
    assert load_stored(*first_sweep(folder), "x", method="full") is None


@pytest.mark.parametrize("damage", [b"", b"not an archive", None])
def test_a_damaged_file_is_as_good_as_none(folder: Path, damage: bytes | None) -> None:
    result, path = keep(folder)
    path.write_bytes(path.read_bytes()[:-200] if damage is None else damage)
    session, one = first_sweep(folder)
    assert load_stored(session, one, "x", method="full") is None
    assert_same(stored_or_decoded(session, one, "x", method="full"), result)


def test_without_hashes_in_the_journal_nothing_is_kept(tmp_path: Path) -> None:
    folder = write_session(tmp_path / "session")
    session, one = first_sweep(folder)
    result = decode_pattern(session, one, "x", method="full")
    assert save_stored(session, one, "x", result, method="full") is None
    assert not (folder / correspondence_store.STORE_NAME).exists()
