"""The folder of a calibration: its photos, kept as the camera gave them, a journal with their hashes, and what follows from them.

::

    DIR/journal.jsonl            one line a photo: what was shown, when, which file and hash; append only
    DIR/photos/PART/0000.jpg     PART is what was measured: response, camera, poses_dry, poses_wet
    DIR/response.json, .html     what `rig calibrate response` found, and its report page
    DIR/calibration.json, .html  what `rig calibrate compute` found, which `rig capture` takes over, and its report page

As in a session, a photo is whole on the disk before its journal line is written.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

from drivers.protocols import Photo
from recon.calibration.calibration_file import UsedPhoto
from recon.sessions.disk import Disk, make_folders, write_fault, write_whole
from recon.sessions.journal import JOURNAL_NAME, JournalWriter
from rig.errors import CaptureError

EVENT = "calibration_photo"
BEGUN = "calibration_begun"
LEFT_OUT = "calibration_photo_left_out"


class CalibrationFolder:
    """Keeps the photos of one part of a calibration; ``photos`` are those of this run.

    A part that is there already is gone on with only where ``go_on`` says so.
    """

    def __init__(self, folder: Path, part: str, *, go_on: bool = False) -> None:
        self.folder = folder
        self.part = part
        self._disk = Disk()
        self._photos_folder = folder / "photos" / part
        if self._photos_folder.exists() and not go_on:
            raise CaptureError(
                f"{self._photos_folder}: is there already, and photos are never overwritten; choose a new folder"
            )
        try:
            make_folders(self._photos_folder, disk=self._disk)
        except OSError as error:
            raise CaptureError(write_fault(self._photos_folder, error)) from error
        # Also files of which a kill left no line in the journal are never overwritten.
        numbers = [int(path.stem) for path in self._photos_folder.iterdir() if path.stem.isdecimal()]
        self._next = max(numbers, default=-1) + 1
        self.journal = JournalWriter(folder / JOURNAL_NAME, disk=self._disk)
        self.photos: list[UsedPhoto] = []

    def begin(self, **facts: object) -> None:
        """Write down with which configuration and devices this run begins."""
        self.journal.append(BEGUN, part=self.part, **facts)

    def leave_out(self, names: Iterable[str]) -> None:
        """Write down that photos of this part (0003) do not count; they stay where they are."""
        for name in names:
            self.journal.append(LEFT_OUT, part=self.part, name=name)

    def save(self, files: tuple[Photo, ...], *, shows: str, **facts: object) -> str:
        """Write the files of one photo, then a journal line for each, and return its name (0003); all are then on disk."""
        name = f"{self._next:04d}"
        self._next += 1
        for file in files:
            path = self._photos_folder / f"{name}{file.suffix.lower()}"
            try:
                write_whole(path, file.data, disk=self._disk)
            except OSError as error:
                raise CaptureError(write_fault(path, error)) from error
            digest = hashlib.sha256(file.data).hexdigest()
            relative = path.relative_to(self.folder).as_posix()
            self.journal.append(EVENT, part=self.part, file=relative, sha256=digest, shows=shows, **facts)
            self.photos.append(UsedPhoto(file=relative, sha256=digest, shows=shows))
        return name

    def __enter__(self) -> "CalibrationFolder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.journal.close()
