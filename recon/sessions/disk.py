"""The few file operations that a session is written with, one by one, because what a power cut leaves depends on each.

POSIX promises that a file's bytes last once the file was flushed, and that a name (a new file, a rename, a new folder) lasts
once the folder that holds it was flushed; until then any part of either may be lost, in any order (T. S. Pillai et al., "All File
Systems Are Not Created Equal", OSDI 2014). A flush that failed must not be repeated: the system may have forgotten what it
could not write, and then reports success (A. Rebello et al., "Can Applications Recover from fsync Failures?", USENIX ATC 2020).
"""

import contextlib
import errno
import os
from pathlib import Path

PART_SUFFIX = ".part"


class Disk:
    """The disk of this machine. Every method raises ``OSError`` as the system says it.

    ``durable=False`` leaves it to the system when anything reaches the disk: for sessions that can be made again.
    """

    def __init__(self, *, durable: bool = True) -> None:
        self._durable = durable

    def make_folder(self, path: Path) -> None:
        """Make a folder; one that is there stays as it is."""
        path.mkdir(exist_ok=True)

    def create(self, path: Path) -> int:
        """Open an empty file for writing."""
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)

    def open_to_append(self, path: Path) -> int:
        """Open a file, made where there is none, whose every write goes to its end."""
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)

    def write(self, file: int, data: bytes) -> None:
        """Write all of ``data``; when this raises, a part of it may be in the file."""
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(file, rest) :]

    def truncate(self, file: int, length: int) -> None:
        """Cut a file."""
        os.ftruncate(file, length)

    def flush(self, file: int) -> None:
        """Return when the bytes of a file are on the disk."""
        if self._durable:
            os.fsync(file)

    def close(self, file: int) -> None:
        """Close a file."""
        os.close(file)

    def rename(self, source: Path, target: Path) -> None:
        """Give a file another name in its folder, in place of whatever bore it."""
        source.replace(target)

    def remove(self, path: Path) -> None:
        """Remove a file."""
        path.unlink()

    def flush_folder(self, path: Path) -> None:
        """Return when the names in a folder are on the disk."""
        if not self._durable:
            return
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def make_folders(folder: Path, *, disk: Disk) -> None:
    """Make a folder and those above it that are missing; their names last when this returns."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing):
        disk.make_folder(path)
    for path in reversed(missing or [folder]):
        disk.flush_folder(path.parent)


def write_whole(path: Path, data: bytes, *, disk: Disk) -> None:
    """Write a file so that it is whole or absent, whenever the power is cut: other name, flush, rename, flush the folder."""
    temporary = path.with_name(path.name + PART_SUFFIX)
    try:
        file = disk.create(temporary)
        try:
            disk.write(file, data)
            disk.flush(file)
        finally:
            disk.close(file)
        disk.rename(temporary, path)
    except OSError:
        with contextlib.suppress(OSError):  # on a full disk, the journal may need the room
            disk.remove(temporary)
        raise
    disk.flush_folder(path.parent)


def write_fault(path: Path, error: OSError) -> str:
    """Say in a sentence that ``path`` could not be written, and what to do about it."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    advice = "free some space" if full else "look after the disk"
    return f"{path}: cannot be written ({error.strerror or error}); {advice}, then resume or start again"
