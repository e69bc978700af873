"""What a calibration's folder holds: with which rig it was begun, and its photos of boards, read back without a camera."""

import hashlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from recon.calibration.board import Board
from recon.calibration.calibration_file import UsedPhoto
from recon.calibration.detection import BoardView, detect_board
from recon.sessions.journal import JOURNAL_NAME, read_journal
from recon.sessions.manifest import DeviceRecord
from recon.sessions.photos import read_grey
from rig.calibrating.calibration_folder import BEGUN, EVENT, LEFT_OUT
from rig.capturing.tag_check import DECODABLE
from rig.config import RigConfig, parse_config
from rig.errors import CaptureError

CAMERA, DRY, WET = "camera", "poses_dry", "poses_wet"


@dataclass(frozen=True, slots=True)
class Begun:
    """The rig that a calibration was begun with; ``simulated`` where its devices were."""

    config: RigConfig
    devices: dict[str, DeviceRecord]
    settings: dict[str, str]

    def refuse_other(self, config: RigConfig, folder: Path) -> None:
        """Raise ``CaptureError`` where photos or display have another size than those of the folder."""
        for what, before, now in (
            ("photos", self.config.camera, config.camera),
            ("a display", self.config.display, config.display),
        ):
            if (before.columns, before.rows) != (now.columns, now.rows):
                raise CaptureError(
                    f"{folder}: was begun with {what} of {before.columns} x {before.rows} px, now {now.columns} x {now.rows} px "
                    "are configured; choose a new folder"
                )


@dataclass(frozen=True, slots=True)
class KeptPhoto:
    """One photo of a board: its name (0003), what it shows, and the board that was held or shown."""

    name: str
    used: UsedPhoto
    board: Board
    position: int | None = None


def begun_with(folder: Path) -> Begun | None:
    """Return the rig of the last run that wrote into the folder; None where none has."""
    last: dict[str, Any] | None = None
    if (folder / JOURNAL_NAME).is_file():
        for entry in read_journal(folder / JOURNAL_NAME):
            if entry["event"] == BEGUN:
                last = entry
    if last is None:
        return None
    return Begun(
        parse_config(last["rig"], source=f"{folder / JOURNAL_NAME}"),
        {name: DeviceRecord.model_validate(record) for name, record in last["devices"].items()},
        last["settings"],
    )


def kept_photos(folder: Path, part: str) -> tuple[KeptPhoto, ...]:
    """Return the photos of a part that count, in order; of a RAW and its JPEG, the one that can be decoded."""
    found: dict[str, KeptPhoto] = {}
    if not (folder / JOURNAL_NAME).is_file():
        return ()
    for entry in read_journal(folder / JOURNAL_NAME):
        if entry.get("part") != part:
            continue
        if entry["event"] == LEFT_OUT:
            found.pop(entry["name"], None)
        elif entry["event"] == EVENT and PurePosixPath(entry["file"]).suffix in DECODABLE:
            name = PurePosixPath(entry["file"]).stem
            used = UsedPhoto(file=entry["file"], sha256=entry["sha256"], shows=entry["shows"])
            found[name] = KeptPhoto(name, used, Board(**entry["board"]), entry.get("position"))
    return tuple(found.values())


def read_view(folder: Path, photo: KeptPhoto, config: RigConfig) -> BoardView:
    """Return the board's corners in a kept photo.

    Raises
    ------
    CaptureError
        Where the file is not the one that was taken.
    SessionError
        Where it is missing, damaged or of another size.
    """
    path = folder / photo.used.file
    grey = read_grey(path, rows=config.camera.rows, cols=config.camera.columns, primary=primary_of(photo, config))
    if hashlib.sha256(path.read_bytes()).hexdigest() != photo.used.sha256:
        raise CaptureError(f"{path}: is not the photo that was taken, its hash differs; restore it, or leave it out")
    return detect_board(grey, photo.board, name=photo.name)


def primary_of(photo: KeptPhoto, config: RigConfig) -> str:
    """Return the colour in which to decode a photo: the display's, or white for a printed board."""
    return "white" if photo.used.shows.startswith("printed") else config.display.primary
