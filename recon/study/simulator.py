"""The simulator as a separate program: studies start ``rig simulate`` and read only the files that it wrote."""

import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from recon.errors import ReconError

SCENE_NAME = "scene.toml"
KEY_NAME = "simulated.txt"

Scene = Mapping[str, object]


def simulated(scene: Scene | str, folder: Path, *, options: Sequence[str] = ()) -> Path:
    """Return the session of a scene in ``folder``, simulated now unless the same one is there already.

    Parameters
    ----------
    scene
        Contents of a scene file (``docs/how-to/write-a-scene.md``), tables of plain values; or a name from ``rig scenes``.
    folder
        Gets ``scene.toml`` and the folder ``session``.
    options
        More words for ``rig simulate``, such as ``--truth-only``.

    Raises
    ------
    ReconError
        Where the program is not there, or says why it cannot.
    """
    text = scene if isinstance(scene, str) else toml_text(scene)
    key = hashlib.sha256("\0".join([text, *options]).encode()).hexdigest()
    session, stamp = folder / "session", folder / KEY_NAME
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == key and session.is_dir():
        return session
    if session.exists():
        raise ReconError(
            f"{session}: holds another simulation than this study needs; choose a new folder, or delete it"
        )
    folder.mkdir(parents=True, exist_ok=True)
    asked = text
    if not isinstance(scene, str):
        asked = str(folder / SCENE_NAME)
        Path(asked).write_text(text, encoding="utf-8")
    ran = subprocess.run(
        [program(), "simulate", asked, str(session), *options], capture_output=True, text=True, check=False
    )
    if ran.returncode != 0:
        raise ReconError(f"rig simulate {asked}: {ran.stderr.strip() or f'ended with {ran.returncode}'}")
    stamp.write_text(key, encoding="utf-8")
    return session


def program() -> str:
    """Return where the program ``rig`` is: beside this Python, or on the path."""
    beside = Path(sys.executable).with_name("rig")
    found = str(beside) if beside.is_file() else shutil.which("rig")
    if found is None:
        raise ReconError(
            "a study needs the simulator, and the program `rig` is neither beside this Python nor on the PATH; "
            "install the whole project, for example with `make setup`"
        )
    return found


def toml_text(scene: Scene) -> str:
    """Return a scene as TOML: plain values first, then its tables.

    Examples
    --------
    >>> print(toml_text({"name": "ball", "specimen": {"kind": "hemisphere", "radius_mm": 20.0}}))
    name = "ball"
    <BLANKLINE>
    [specimen]
    kind = "hemisphere"
    radius_mm = 20.0
    <BLANKLINE>
    """
    plain = {name: value for name, value in scene.items() if not isinstance(value, Mapping)}
    lines = [f"{name} = {json.dumps(value)}" for name, value in plain.items()]
    for name, table in scene.items():
        if isinstance(table, Mapping):
            lines += ["", f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"
