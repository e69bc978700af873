"""What is on a disk after the power was cut: a record of every file operation, and the worst that POSIX lets become of it.

A file's bytes last once the file was flushed, a name once its folder was flushed. Of the rest any part may be lost: a write may
be gone, torn, followed by zeros or holed by a zeroed sector; a new name, a rename or a removal may not have happened, whether or
not later ones did.
"""

import copy
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from recon.sessions.disk import Disk

FOLDER = -1
SECTOR_BYTES = 512
Tree = dict[str, bytes | None]  # a path's bytes, None for a folder
Names = dict[str, int | None]  # a name's file, FOLDER, or None where it was removed


@dataclass(frozen=True, slots=True)
class Operation:
    """One call of :class:`recon.sessions.disk.Disk`; a file that is open is named by a number of its own."""

    kind: str
    path: str = ""
    target: str = ""
    file: int = 0
    data: bytes = b""
    length: int = 0


@dataclass(slots=True)
class File:
    """What a program sees in a file, what is on the disk, and what was done to it since its last flush."""

    seen: bytes = b""
    kept: bytes = b""
    pending: list[Operation] = field(default_factory=list)


@dataclass(slots=True)
class Folder:
    """The same of a folder's names."""

    seen: Names = field(default_factory=dict)
    kept: Names = field(default_factory=dict)
    pending: list[Names] = field(default_factory=list)


class DiskModel:
    """A folder as it stands after some operations."""

    def __init__(self, tree: Tree) -> None:
        self._files: list[File] = []
        self._folders: dict[str, Folder] = {".": Folder()}
        self._open: dict[int, File] = {}
        for path, data in sorted(tree.items()):
            parent, name = _split(path)
            if data is None:
                self._folders[path] = Folder()
            else:
                self._files.append(File(data, data))
            number = FOLDER if data is None else len(self._files) - 1
            self._folders[parent].seen[name] = self._folders[parent].kept[name] = number

    def after(self, operations: list[Operation]) -> "DiskModel":
        """Return the folder after these operations too."""
        model = copy.deepcopy(self)
        for operation in operations:
            getattr(model, f"_{operation.kind}")(operation)
        return model

    def seen(self) -> Tree:
        """Return what a program sees, as after a kill."""
        return self._tree({path: folder.seen for path, folder in self._folders.items()}, lambda file: file.seen)

    def after_power_cut(self, rng: random.Random) -> Tree:
        """Return what is on the disk when the power comes back."""
        names = {}
        for path, folder in self._folders.items():
            names[path] = dict(folder.kept)
            for change in folder.pending:
                if rng.random() < 0.5:
                    names[path] |= change
        return self._tree(names, lambda file: _torn(file, rng))

    def _tree(self, names: dict[str, Names], bytes_of: Callable[[File], bytes]) -> Tree:
        tree: Tree = {}
        reached = ["."]
        for path in reached:  # grows while it is walked
            for name, number in names[path].items():
                place = name if path == "." else f"{path}/{name}"
                if number == FOLDER:
                    tree[place] = None
                    reached.append(place)
                elif number is not None:
                    tree[place] = bytes_of(self._files[number])
        return tree

    def _rename_in(self, path: str, change: Names) -> None:
        self._folders[path].seen |= change
        self._folders[path].pending.append(change)

    def _find(self, path: str) -> int | None:
        parent, name = _split(path)
        return self._folders[parent].seen.get(name)

    def _make_folder(self, operation: Operation) -> None:
        if self._find(operation.path) is None:
            parent, name = _split(operation.path)
            self._folders[operation.path] = Folder()
            self._rename_in(parent, {name: FOLDER})

    def _create(self, operation: Operation) -> None:
        self._open_to_append(operation)
        if self._open[operation.file].seen:
            self._truncate(operation)

    def _open_to_append(self, operation: Operation) -> None:
        number = self._find(operation.path)
        if number is None:
            parent, name = _split(operation.path)
            self._files.append(File())
            number = len(self._files) - 1
            self._rename_in(parent, {name: number})
        self._open[operation.file] = self._files[number]

    def _write(self, operation: Operation) -> None:
        file = self._open[operation.file]
        file.seen += operation.data
        file.pending.append(operation)

    def _truncate(self, operation: Operation) -> None:
        file = self._open[operation.file]
        if operation.length != len(file.seen):
            file.seen = file.seen[: operation.length]
            file.pending.append(Operation("truncate", length=operation.length))

    def _flush(self, operation: Operation) -> None:
        file = self._open[operation.file]
        file.kept, file.pending = file.seen, []

    def _flush_folder(self, operation: Operation) -> None:
        folder = self._folders[operation.path]
        folder.kept, folder.pending = dict(folder.seen), []

    def _rename(self, operation: Operation) -> None:
        parent, name = _split(operation.path)
        self._rename_in(parent, {name: None, _split(operation.target)[1]: self._find(operation.path)})

    def _remove(self, operation: Operation) -> None:
        parent, name = _split(operation.path)
        self._rename_in(parent, {name: None})


def _split(path: str) -> tuple[str, str]:
    parent, _, name = path.rpartition("/")
    return parent or ".", name


def _torn(file: File, rng: random.Random) -> bytes:
    """Return one of the ways in which the bytes since the last flush may have reached the disk."""
    data = file.kept
    for operation in file.pending[: rng.randint(0, len(file.pending))]:
        data = data[: operation.length] if operation.kind == "truncate" else data + operation.data
    new = len(data) - len(file.kept)
    if new <= 0:
        return data
    start = len(file.kept) + rng.randrange(new)
    match rng.choice(("whole", "torn", "zeros", "hole")):
        case "torn":
            return data[:start]
        case "zeros":
            return data[:start].ljust(len(data), b"\0")
        case "hole":
            end = min(len(data), (start // SECTOR_BYTES + 1) * SECTOR_BYTES)
            return data[:start] + bytes(end - start) + data[end:]
    return data


class RecordingDisk(Disk):
    """The real disk, and a record of what is done to the files under ``root``; ``on_operation`` is called before each.

    Operations of the kind ``forgotten`` are not in the record, as if the program had left them out.
    """

    def __init__(self, root: Path, on_operation: Callable[[], None], *, forgotten: str = "") -> None:
        super().__init__(durable=False)  # the record says what was flushed; the disk need not do it
        self._root = root
        self._forgotten = forgotten
        self._on_operation = on_operation
        self._numbers: dict[int, int] = {}
        self.operations: list[Operation] = []

    def _take_down(self, operation: Operation) -> None:
        if operation.kind != self._forgotten:
            self._on_operation()
            self.operations.append(operation)

    def _place(self, path: Path) -> str:
        return path.relative_to(self._root).as_posix()

    def make_folder(self, path: Path) -> None:
        self._take_down(Operation("make_folder", self._place(path)))
        super().make_folder(path)

    def create(self, path: Path) -> int:
        return self._opened("create", path, super().create(path))

    def open_to_append(self, path: Path) -> int:
        return self._opened("open_to_append", path, super().open_to_append(path))

    def _opened(self, kind: str, path: Path, file: int) -> int:
        self._numbers[file] = len(self.operations)
        self._take_down(Operation(kind, self._place(path), file=self._numbers[file]))
        return file

    def write(self, file: int, data: bytes) -> None:
        self._take_down(Operation("write", file=self._numbers[file], data=data))
        super().write(file, data)

    def truncate(self, file: int, length: int) -> None:
        self._take_down(Operation("truncate", file=self._numbers[file], length=length))
        super().truncate(file, length)

    def flush(self, file: int) -> None:
        self._take_down(Operation("flush", file=self._numbers[file]))

    def rename(self, source: Path, target: Path) -> None:
        self._take_down(Operation("rename", self._place(source), self._place(target)))
        super().rename(source, target)

    def remove(self, path: Path) -> None:
        self._take_down(Operation("remove", self._place(path)))
        super().remove(path)

    def flush_folder(self, path: Path) -> None:
        self._take_down(Operation("flush_folder", self._place(path)))


def tree_of(root: Path) -> Tree:
    """Return what is in a folder."""
    paths = sorted(root.rglob("*"))
    return {path.relative_to(root).as_posix(): None if path.is_dir() else path.read_bytes() for path in paths}


def write_tree(tree: Tree, root: Path) -> None:
    """Make a folder of what was in another."""
    root.mkdir()
    for path, data in sorted(tree.items()):
        if data is None:
            (root / path).mkdir()
        else:
            (root / path).write_bytes(data)
