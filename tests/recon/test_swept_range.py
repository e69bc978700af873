"""A sweep that the journal narrows is a shorter sweep everywhere; a rejected sweep has no photos."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from session_example import PLACES, write_session

from recon.errors import SessionError
from recon.method import Method
from recon.sessions.photos import read_grey
from recon.sessions.session import SessionWriter, open_session
from recon.sessions.wholeness import faults, missing_photos
from recon.sweeps.correspondence import decode_sweep


def append(folder: Path, event: str, **fields: object) -> None:
    with (folder / "journal.jsonl").open("a") as journal:
        journal.write(json.dumps({"event": event, **fields}) + "\n")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_session(tmp_path / "session")


def drop_photos(folder: Path, set_name: str, axis: str, *, keep: range) -> None:
    """Take back the photos of one sweep outside ``keep``, as if they had never been shot."""
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    kept = []
    for line in lines:
        if (line["set"], line["sweep"]) == (set_name, axis) and line["index"] not in keep:
            (folder / line["file"]).unlink()
        else:
            kept.append(line)
    (folder / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in kept))


def test_a_narrowed_sweep_begins_at_its_first_stripe_and_keeps_the_numbers_of_its_photos(folder: Path) -> None:
    append(folder, "sweep_range", set="pos0_air", axis="x", first_index=1, last_index=3)
    session = open_session(folder)
    one = session.manifest.set_named("pos0_air")
    pattern = one.sweep("x").pattern
    assert (pattern.first_px, pattern.step_px, pattern.count) == (1.0, 1.0, 3)
    assert list(session.photo_numbers(one, "x")) == [1, 2, 3]
    assert one.sweep("y").pattern.count == PLACES
    assert list(session.photo_numbers(one, "y")) == list(range(PLACES))


def test_a_narrowed_session_is_whole_without_the_photos_outside(folder: Path) -> None:
    drop_photos(folder, "pos0_air", "x", keep=range(1, 4))
    assert [fault for fault in missing_photos(open_session(folder)) if not fault.is_warning]
    append(folder, "sweep_range", set="pos0_air", axis="x", first_index=1, last_index=3)
    assert [fault for fault in faults(open_session(folder)) if not fault.is_warning] == []


def test_a_pixel_within_the_range_is_decoded_to_the_same_place(folder: Path) -> None:
    one = open_session(folder).manifest.set_named("pos0_air")
    whole = decode_sweep(open_session(folder), one, "x", method="paper")
    append(folder, "sweep_range", set="pos0_air", axis="x", first_index=1, last_index=4)
    session = open_session(folder)
    part = decode_sweep(session, session.manifest.set_named("pos0_air"), "x", method="paper")
    # Stripes 2 and 3 light columns 6 and 9; the stripe at the end of a sweep may have its peak beyond.
    for column in (6, 9):
        # first_px + index adds up in another order: to the last bit of a double.
        np.testing.assert_allclose(part.place_px[:, column], whole.place_px[:, column], rtol=0, atol=1e-12)
        assert np.isfinite(part.place_px[:, column]).all()
    assert [photo.index for photo in part.photos] == [1, 2, 3, 4]


@pytest.mark.parametrize("method", ["paper", "full"])
def test_a_photo_that_is_wanted_before_the_sweep_is_decoded_once(
    folder: Path, method: Method, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: list[str] = []

    def counted(path: Path, **settings: Any) -> np.ndarray:
        decoded.append(path.name)
        return read_grey(path, **settings)

    monkeypatch.setattr("recon.sweeps.photo_stream.read_grey", counted)
    session = open_session(folder)
    decode_sweep(session, session.manifest.set_named("pos0_air"), "x", method=method)
    assert sorted(decoded) == sorted(set(decoded))
    assert len(decoded) >= 5


@pytest.mark.parametrize(("first", "last"), [(0, 1), (3, 5), (4, 2)])
def test_a_range_that_the_sweep_does_not_hold_is_refused_in_one_sentence(folder: Path, first: int, last: int) -> None:
    append(folder, "sweep_range", set="pos0_air", axis="x", first_index=first, last_index=last)
    with pytest.raises(SessionError, match=r"pos0_air/x is .* at least 3 of the 5 stripes"):
        open_session(folder)


def test_a_range_of_a_set_that_does_not_exist_is_refused(folder: Path) -> None:
    append(folder, "sweep_range", set="pos9_air", axis="x", first_index=0, last_index=3)
    with pytest.raises(SessionError, match="no set 'pos9_air'"):
        open_session(folder)


def test_the_last_range_counts(folder: Path) -> None:
    append(folder, "sweep_range", set="pos0_air", axis="x", first_index=0, last_index=2)
    append(folder, "sweep_range", set="pos0_air", axis="x", first_index=1, last_index=4)
    session = open_session(folder)
    assert list(session.photo_numbers(session.manifest.set_named("pos0_air"), "x")) == [1, 2, 3, 4]


def test_a_rejected_sweep_has_no_photos_until_it_is_taken_again_and_its_files_stay(folder: Path) -> None:
    before = (folder / "photos/pos0_air/x/0000.jpg").read_bytes()
    with SessionWriter.reopen(folder) as writer:
        writer.reject_sweep("pos0_air", "x", reason="the display was off")
        session = open_session(folder)
        assert not [key for key in session.photos if key[:2] == ("pos0_air", "x")]
        assert len([key for key in session.photos if key[:2] == ("pos0_air", "y")]) == PLACES
        record = writer.save_photo(b"new", set_name="pos0_air", sweep="x", index=0)
    assert record.file == "photos/pos0_air/x-2/0000.jpg"
    assert open_session(folder).photo_file("pos0_air", "x", 0) == folder / record.file
    assert (folder / "photos/pos0_air/x/0000.jpg").read_bytes() == before
    with SessionWriter.reopen(folder) as writer:  # another process: it finds how often the sweep was rejected
        assert (
            writer.save_photo(b"more", set_name="pos0_air", sweep="x", index=1).file == "photos/pos0_air/x-2/0001.jpg"
        )
