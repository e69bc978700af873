"""A session on a disk that fails: what was acknowledged lasts, what was not can be told, and no half of a line stays."""

import errno
import json
import os
from pathlib import Path

import pytest
from session_example import manifest

from recon.errors import SessionError
from recon.sessions.disk import Disk
from recon.sessions.journal import JournalWriter, read_journal
from recon.sessions.session import SessionWriter, open_session, parse_manifest

MANIFEST = parse_manifest(json.dumps(manifest()), source="example")


class FailingDisk(Disk):
    """Fails once, at the call that :meth:`fail` names; a write that fails has written half of its bytes."""

    def __init__(self) -> None:
        super().__init__()
        self._method, self._left, self._code = "", 0, 0

    def fail(self, method: str, *, call: int, code: int) -> None:
        self._method, self._left, self._code = method, call, code

    def _perhaps_fail(self, method: str) -> None:
        if method == self._method:
            self._left -= 1
            if self._left == 0:
                raise OSError(self._code, os.strerror(self._code))

    def write(self, file: int, data: bytes) -> None:
        try:
            self._perhaps_fail("write")
        except OSError:
            super().write(file, data[: len(data) // 2])
            raise
        super().write(file, data)

    def flush(self, file: int) -> None:
        self._perhaps_fail("flush")
        super().flush(file)

    def flush_folder(self, path: Path) -> None:
        self._perhaps_fail("flush_folder")
        super().flush_folder(path)

    def rename(self, source: Path, target: Path) -> None:
        self._perhaps_fail("rename")
        super().rename(source, target)


def lines_of(folder: Path) -> list[dict[str, object]]:
    """Parse the journal strictly: every byte belongs to a line of JSON."""
    data = (folder / "journal.jsonl").read_bytes()
    assert not data or data.endswith(b"\n")
    return [json.loads(line) for line in data.splitlines()]


def take(writer: SessionWriter, index: int) -> None:
    writer.save_photo(f"photo {index}".encode() * 1000, set_name="pos0_air", sweep="x", index=index)


# A photo takes these calls: its bytes are written and flushed, it is renamed, its folder is flushed; then its line is.
PHOTO_CALLS = [("write", 1), ("flush", 1), ("rename", 1), ("flush_folder", 1)]
LINE_CALLS = [("write", 2), ("flush", 2)]


@pytest.mark.parametrize(("method", "call"), PHOTO_CALLS + LINE_CALLS)
@pytest.mark.parametrize(
    ("code", "said"), [(errno.ENOSPC, "No space left on device); free some space"), (errno.EIO, "error); look after")]
)
def test_a_photo_that_the_disk_does_not_take_is_refused_in_one_sentence_and_does_not_count(
    tmp_path: Path, method: str, call: int, code: int, said: str
) -> None:
    disk = FailingDisk()
    with SessionWriter.create(tmp_path / "s", MANIFEST, disk=disk) as writer:
        take(writer, 0)
        disk.fail(method, call=call, code=code)
        with pytest.raises(SessionError) as refused:
            take(writer, 1)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    assert [entry["index"] for entry in lines_of(tmp_path / "s")] == [0]
    with SessionWriter.reopen(tmp_path / "s") as writer:
        take(writer, 1)
    assert [entry["index"] for entry in lines_of(tmp_path / "s")] == [0, 1]
    assert list((tmp_path / "s").rglob("*.part")) == []


def test_a_full_disk_leaves_no_half_photo_that_takes_the_room_of_a_line(tmp_path: Path) -> None:
    disk = FailingDisk()
    with SessionWriter.create(tmp_path / "s", MANIFEST, disk=disk) as writer:
        disk.fail("write", call=1, code=errno.ENOSPC)
        with pytest.raises(SessionError):
            take(writer, 0)
        assert [path for path in (tmp_path / "s/photos").rglob("*") if path.is_file()] == []
        writer.journal.append("came_to_rest")
    assert [entry["event"] for entry in lines_of(tmp_path / "s")] == ["came_to_rest"]


def test_a_half_written_line_is_taken_back_before_the_next(tmp_path: Path) -> None:
    disk = FailingDisk()
    with SessionWriter.create(tmp_path / "s", MANIFEST, disk=disk) as writer:
        take(writer, 0)
        disk.fail("write", call=1, code=errno.ENOSPC)
        with pytest.raises(SessionError):
            writer.journal.append("move_started")
        writer.journal.append("came_to_rest")
    assert [entry["event"] for entry in lines_of(tmp_path / "s")] == ["photo", "came_to_rest"]


def test_after_a_flush_that_failed_no_line_is_written_until_the_journal_is_read_again(tmp_path: Path) -> None:
    """The system may have forgotten the pages that it could not write; the next flush would succeed without them."""
    disk = FailingDisk()
    with SessionWriter.create(tmp_path / "s", MANIFEST, disk=disk) as writer:
        take(writer, 0)
        disk.fail("flush", call=2, code=errno.EIO)
        for index in (1, 2):
            with pytest.raises(SessionError, match=r"journal.jsonl: cannot be written \(Input/output error\)"):
                take(writer, index)
    assert [entry["index"] for entry in lines_of(tmp_path / "s")] == [0]


def test_a_line_that_ctrl_c_interrupted_is_whole_or_gone_before_the_next(tmp_path: Path) -> None:
    class Interrupted(Disk):
        """Ctrl-C comes when half of the second line is written, and just behind the fourth."""

        lines = 0

        def write(self, file: int, data: bytes) -> None:
            self.lines += 1
            super().write(file, data[: len(data) // 2] if self.lines == 2 else data)
            if self.lines in (2, 4):
                raise KeyboardInterrupt

    with JournalWriter(tmp_path / "journal.jsonl", disk=Interrupted()) as journal:
        for name in ("first", "second", "third", "fourth", "fifth"):
            try:
                journal.append(name)
            except KeyboardInterrupt:
                continue
    assert [entry["event"] for entry in lines_of(tmp_path)] == ["first", "third", "fourth", "fifth"]


@pytest.mark.parametrize(
    "tail", [b'{"event": "move_sta', b"\0" * 40, b'{"event": "photo", "f\0\0\0\0\0\0\0\0"}\n', b'{"a": 1\0\0\n{"b"']
)
def test_a_torn_end_is_dropped_on_reading_and_cut_on_writing(tmp_path: Path, tail: bytes) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b'{"event": "first"}\n{"event": "second"}\n' + tail)
    assert [entry["event"] for entry in read_journal(path)] == ["first", "second"]
    with JournalWriter(path, disk=Disk()) as journal:
        journal.append("third")
    assert [entry["event"] for entry in lines_of(tmp_path)] == ["first", "second", "third"]


def test_a_beginning_that_was_cut_short_gives_way_to_a_new_one(tmp_path: Path) -> None:
    disk = FailingDisk()
    disk.fail("rename", call=1, code=errno.EIO)
    with pytest.raises(SessionError):
        SessionWriter.create(tmp_path / "s", MANIFEST, disk=disk)
    (tmp_path / "s/manifest.json.part").write_text("half a mani")
    with SessionWriter.create(tmp_path / "s", MANIFEST) as writer:
        take(writer, 0)
    assert len(open_session(tmp_path / "s").photos) == 1
    with pytest.raises(SessionError, match="not empty"):
        SessionWriter.create(tmp_path / "s", MANIFEST)
    assert len(open_session(tmp_path / "s").photos) == 1
