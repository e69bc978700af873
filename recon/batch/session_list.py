"""Which sessions a batch is asked for, and what each is called in it."""

import glob
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from recon.errors import ReconError

GLOB_CHARACTERS = "*?["


def sessions_asked(arguments: Sequence[str]) -> dict[str, Path]:
    """Return the sessions by their names in the batch, in the order asked, each once.

    Parameters
    ----------
    arguments
        Each a folder; a pattern such as ``scans/*``, of which the folders count; or a text file with one folder a line,
        relative to the file's own place, where empty lines and those that begin with ``#`` say nothing.

    Raises
    ------
    ReconError
        For an argument that names nothing, and for two sessions that cannot be told apart by name.
    """
    folders: dict[Path, None] = {}
    for argument in arguments:
        folders.update(dict.fromkeys(folder.resolve() for folder in _folders(argument)))
    if not folders:
        raise ReconError(
            "no session was named; give folders, a pattern in quotes, or a text file with one folder a line"
        )
    return _named(tuple(folders))


def _folders(argument: str) -> list[Path]:
    path = Path(argument)
    if path.is_file():
        return _listed(path)
    # A folder whose own name holds such a character is that folder.
    if not path.exists() and any(character in argument for character in GLOB_CHARACTERS):
        found = [Path(name) for name in sorted(glob.glob(argument, recursive=True)) if Path(name).is_dir()]
        if not found:
            raise ReconError(f"{argument}: no folder has a name of this pattern; look at it with `ls`")
        return found
    # One that is missing is the fault of that session alone, which the batch names among the others.
    return [path]


def _listed(path: Path) -> list[Path]:
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise ReconError(f"{path}: not a list of sessions ({error}); write one folder a line") from None
    named = [path.parent / line for line in lines if line and not line.startswith("#")]
    if not named:
        raise ReconError(f"{path}: lists no session; write one folder a line")
    return named


def _named(folders: tuple[Path, ...]) -> dict[str, Path]:
    """Call each session by its folder, and those that share a name by the folder above as well."""
    shared = Counter(folder.name for folder in folders)
    names = [folder.name if shared[folder.name] == 1 else f"{folder.parent.name}-{folder.name}" for folder in folders]
    for name, count in Counter(names).items():
        if count > 1:
            alike = " and ".join(str(folder) for folder, own in zip(folders, names, strict=True) if own == name)
            raise ReconError(f"{alike} would both be called {name} in the batch; rename one, or make two batches")
    return dict(zip(names, folders, strict=True))
