"""A disk that fills up in the middle of a capture: what is on it then, and how the capture goes on."""

import errno
import json
import os
import random
from pathlib import Path
from typing import Any

import pytest

import recon.sessions.session
from drivers.errors import DeviceTimeoutError
from recon.errors import SessionError
from recon.sessions.disk import Disk
from recon.sessions.session import open_session
from rig.capturing.capture import capture
from rig.errors import CaptureError


class SmallDisk(Disk):
    """Takes so many bytes; of a write that does not fit it takes what does, as a real disk does."""

    def __init__(self, room: float) -> None:
        super().__init__(durable=False)
        self.room = room
        self.refused = 0

    def write(self, file: int, data: bytes) -> None:
        fits = int(min(len(data), self.room))
        super().write(file, data[:fits])
        self.room -= fits
        if fits < len(data):
            self.refused += 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def create(self, path: Path) -> int:
        self.room += path.stat().st_size if path.exists() else 0
        return super().create(path)

    def truncate(self, file: int, length: int) -> None:
        self.room += os.fstat(file).st_size - length
        super().truncate(file, length)

    def remove(self, path: Path) -> None:
        self.room += path.stat().st_size
        super().remove(path)


@pytest.fixture
def on_disk(monkeypatch: pytest.MonkeyPatch):
    """Return ``on_disk(disk)``: from now on sessions are written with it."""
    return lambda disk: monkeypatch.setattr(recon.sessions.session, "DISK", disk)


def lines_of(folder: Path) -> list[dict[str, Any]]:
    """Parse the journal strictly: every byte belongs to a whole line."""
    data = (folder / "journal.jsonl").read_bytes()
    assert not data or data.endswith(b"\n")
    return [json.loads(line) for line in data.splitlines()]


@pytest.fixture(scope="module")
def whole_bytes(captured: Path) -> int:
    return sum(path.stat().st_size for path in captured.rglob("*") if path.is_file())


def test_a_disk_that_fills_up_anywhere_leaves_a_session_that_resumes_to_the_same_bytes(
    open_bench, config, scene, quiet, tmp_path, captured, read_photo_bytes, whole_bytes, on_disk
) -> None:
    """The room is drawn at random, so that photos, journal lines and the manifest are hit, at their first and later bytes."""
    rng = random.Random(4)
    manifest_bytes = (captured / "manifest.json").stat().st_size
    rooms = [
        0,
        manifest_bytes - 1,
        manifest_bytes,
        *(rng.randrange(manifest_bytes, whole_bytes - 1000) for _ in range(12)),
    ]
    said = set()
    for number, room in enumerate(rooms):
        folder = tmp_path / f"session{number}"
        disk = SmallDisk(room)
        on_disk(disk)
        with open_bench(config, scene) as (devices, world):
            with pytest.raises(SessionError) as full:
                capture(config, folder, devices=devices, scene=scene, resume=False, console=quiet)
            assert world.flow_direction() is None
            assert not world.is_moving()
        said.add(str(full.value).split(":")[0].removeprefix(f"{folder}/").split("/")[0])
        assert "No space left on device" in str(full.value)
        assert "\n" not in str(full.value)
        assert list(folder.rglob("*.part")) == []
        begun = (folder / "manifest.json").exists()
        assert begun is (room >= manifest_bytes)
        if begun:
            lines_of(folder)
        disk.room = 1e9
        with open_bench(config, scene) as (devices, _):
            capture(config, folder, devices=devices, scene=scene, resume=begun, console=quiet)
        assert read_photo_bytes(folder) == read_photo_bytes(captured)
        lines_of(folder)
    assert said >= {"photos", "journal.jsonl"}  # the draw did hit both


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_a_capture_on_a_full_disk_goes_on_by_itself_when_there_is_room(
    open_bench, config, scene, quiet, tmp_path, captured, read_photo_bytes, whole_bytes, on_disk, share: float
) -> None:
    disk = SmallDisk(share * whole_bytes)
    on_disk(disk)
    with open_bench(config, scene) as (devices, world):
        sleep_s = world.clock.sleep_s

        def until_somebody_made_room(duration_s: float) -> None:
            sleep_s(duration_s)
            if disk.refused >= 5:
                disk.room = 1e9

        world.clock.sleep_s = until_somebody_made_room
        result = capture(config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=quiet)
        assert world.disturbed_photos == 0
    assert disk.refused >= 5
    assert result.photos_taken == 72
    assert read_photo_bytes(tmp_path / "s") == read_photo_bytes(captured)
    assert lines_of(tmp_path / "s")[-1]["event"] == "capture_finished"


def test_a_pump_that_runs_on_is_told_even_where_the_journal_has_no_room_for_it(
    open_bench, config, scene, quiet, tmp_path, on_disk
) -> None:
    disk = SmallDisk(1e9)
    on_disk(disk)
    with open_bench(config, scene) as (devices, world):
        status, stop = devices.pump.status, devices.pump.stop

        def disk_fills_up_in_mid_fill() -> Any:
            if world.flow_direction() == "fill" and world.state().tank_ml > 1000:
                disk.room = 0
                raise DeviceTimeoutError("pump: silent")
            return status()

        def deaf() -> None:
            if world.flow_direction() == "fill":
                raise DeviceTimeoutError("pump: does not obey")
            stop()

        devices.pump.status, devices.pump.stop = disk_fills_up_in_mid_fill, deaf
        with pytest.raises(CaptureError, match=r"switch it off by hand.*does not obey"):
            capture(config, tmp_path / "s", devices=devices, scene=scene, resume=False, console=quiet)
        assert disk.refused >= 2


class FailsToFlush(Disk):
    """The flush number ``at`` fails as on a disk that is dying; the system then says that the next ones succeed."""

    def __init__(self, at: int) -> None:
        super().__init__(durable=False)
        self._flushes = 0
        self._at = at

    def flush(self, file: int) -> None:
        self._flushes += 1
        if self._flushes == self._at:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        super().flush(file)


@pytest.mark.parametrize("at", [1, 2, 3, 40, 41, 120, 121])
def test_a_flush_that_fails_stops_the_capture_in_one_sentence_and_its_photo_does_not_count(
    open_bench, config, scene, quiet, tmp_path, captured, read_photo_bytes, on_disk, at: int
) -> None:
    folder = tmp_path / "s"
    on_disk(FailsToFlush(at))
    with open_bench(config, scene) as (devices, world):
        shutter: list[int] = []
        expose = devices.camera.expose

        def counted(*, timeout_s: float) -> None:
            expose(timeout_s=timeout_s)
            shutter.append(1)

        devices.camera.expose = counted
        with pytest.raises(SessionError, match=r"Input/output error\); look after the disk") as dying:
            capture(config, folder, devices=devices, scene=scene, resume=False, console=quiet)
        assert "\n" not in str(dying.value)
        assert world.flow_direction() is None
        assert not world.is_moving()
    begun = (folder / "manifest.json").exists()
    done = len(open_session(folder).photos) if begun else 0
    on_disk(Disk(durable=False))
    with open_bench(config, scene) as (devices, _):
        result = capture(config, folder, devices=devices, scene=scene, resume=begun, console=quiet)
    assert result.photos_taken == 72 - done
    # All but those in doubt: the one that was written, and the next one, which was exposed meanwhile.
    assert len(shutter) - 2 <= done <= len(shutter)
    assert read_photo_bytes(folder) == read_photo_bytes(captured)
