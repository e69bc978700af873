"""Turn a folder of photos that someone else took into a session, without re-encoding a single one.

The layout file (TOML) holds the manifest's fields in the manifest's words, with two sections of its own: ``[pattern]`` for
every sweep that has none, and ``[photos]`` for the names of the files. ``docs/how-to/import-photos.md`` walks through one.
"""

import hashlib
import os
import shutil
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from recon.bad_value import first_fault
from recon.errors import SessionError
from recon.patterns.pattern_frames import place_of_photo
from recon.sessions.journal import now_text
from recon.sessions.manifest import CaptureSet, Manifest
from recon.sessions.session import SessionWriter, check_inside, photo_path

CONDITIONS = {"liquid": ("air", "liquid"), "thin": ("without", "with")}


class PhotoNames(BaseModel):
    """How the files are called. ``{folder}``, ``{set}``, ``{axis}`` and ``{number}`` are filled in.

    ``folders`` gives the folder of each set where it is not called like the set; ``white`` and ``black`` may be absent.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    stripe: str = "{folder}/{axis}/{number:04d}.jpg"
    first_number: Annotated[int, Field(ge=0)] = 0
    white: str | None = None
    black: str | None = None
    folders: dict[str, str] = {}


@dataclass(frozen=True, slots=True)
class Layout:
    """A parsed layout file: what the photos mean, and what they are called."""

    manifest: Manifest
    names: PhotoNames


def read_layout(path: Path) -> Layout:
    """Read a layout file; a fault is a one-sentence ``SessionError`` that names the field."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise SessionError(f"{path}: no such layout file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise SessionError(f"{path}: cannot be read ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise SessionError(f"{path}: not TOML ({error})") from None
    try:
        names = PhotoNames.model_validate(data.pop("photos", {}))
        return Layout(Manifest.model_validate(_manifest_fields(data, path)), names)
    except ValidationError as error:
        raise SessionError(f"{path}: {first_fault(error, whole='layout')}") from None


def _manifest_fields(data: dict[str, Any], path: Path) -> dict[str, Any]:
    pattern = data.pop("pattern", None)
    data.setdefault("schema_version", 1)
    data.setdefault("created", now_text())
    data.setdefault("method", "liquid")
    data.setdefault("sets", _four_sets(data["method"]))
    for capture_set in data["sets"]:
        capture_set.setdefault("sweeps", [{"axis": "x"}, {"axis": "y"}])
        for sweep in capture_set["sweeps"]:
            if "pattern" not in sweep and pattern is None:
                raise SessionError(f"{path}: [pattern] is missing: say which stripe was shown and where it began")
            sweep.setdefault("pattern", pattern)
    scene_units = data.get("length_unit") == "scene unit"
    note = "Imported photos." + (" One scene unit is stored as 1 mm." if scene_units else "")
    data.setdefault(
        "provenance",
        {
            "software": {"recon": version("refractive-scan")},
            "devices": {"camera": {"kind": "unknown"}, "display": {"kind": "unknown"}},
            "note": note,
        },
    )
    return data


def _four_sets(method: str) -> list[dict[str, Any]]:
    return [
        {"position": position, "condition": condition}
        for condition in CONDITIONS.get(method, ("air", "liquid"))
        for position in (0, 1)
    ]


@dataclass(frozen=True, slots=True)
class _Wanted:
    source: str
    set_name: str
    sweep: str
    index: int
    place_px: float | None


def _wanted(layout: Layout) -> Iterator[_Wanted]:
    for capture_set in layout.manifest.sets:
        yield from _wanted_of_set(capture_set, layout.names)


def _wanted_of_set(capture_set: CaptureSet, names: PhotoNames) -> Iterator[_Wanted]:
    words = {"set": capture_set.name, "folder": names.folders.get(capture_set.name, capture_set.name)}
    for single in ("white", "black"):
        name = getattr(names, single)
        if name is not None:
            yield _Wanted(_fill(name, words), capture_set.name, single, 0, None)
    for sweep in capture_set.sweeps:
        for index in range(sweep.pattern.count):
            filled = _fill(names.stripe, {**words, "axis": sweep.axis, "number": names.first_number + index})
            yield _Wanted(filled, capture_set.name, sweep.axis, index, place_of_photo(sweep.pattern, index))


def _fill(name: str, words: dict[str, Any]) -> str:
    try:
        filled = name.format(**words)
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        raise SessionError(
            f"[photos]: {name!r} cannot be filled in ({error}); known words are {', '.join(sorted(words))}"
        ) from None
    check_inside(filled, what="[photos]")
    return filled


def import_folder(
    folder: Path, session: Path, layout: Layout, *, on_photo: Callable[[int, int], None] | None = None
) -> int:
    """Make ``session`` from the photos in ``folder``; return how many there are.

    Photos are hard-linked where both folders are on one disk, otherwise copied once. Every photo is looked for before
    anything is written, so that a missing one leaves nothing behind.
    """
    if not folder.is_dir():
        raise SessionError(f"{folder}: no such folder")
    wanted = list(_wanted(layout))
    missing = [item.source for item in wanted if not (folder / item.source).is_file()]
    if missing:
        others = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise SessionError(
            f"{folder}: {missing[0]}{others} of {len(wanted)} photos not found; check [photos] and [pattern] in the layout"
        )
    with SessionWriter.create(session, layout.manifest) as writer:
        for done, item in enumerate(wanted, start=1):
            _bring(folder / item.source, writer, item)
            if on_photo is not None:
                on_photo(done, len(wanted))
    return len(wanted)


def _bring(source: Path, writer: SessionWriter, item: _Wanted) -> None:
    relative = photo_path(item.set_name, item.sweep, item.index, source.suffix.lower())
    target = writer.folder / relative
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source, target)
        except OSError:
            # Another disk, or a file system without hard links: one copy.
            shutil.copyfile(source, target)
        data = target.read_bytes()
        writer.journal.append(
            "photo",
            set=item.set_name,
            sweep=item.sweep,
            index=item.index,
            place_px=item.place_px,
            file=relative,
            sha256=hashlib.sha256(data).hexdigest(),
            bytes=len(data),
            device={},
        )
    except OSError as error:
        raise SessionError(
            f"{target}: cannot be written ({error.strerror}); free some space and start again"
        ) from error
