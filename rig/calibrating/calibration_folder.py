"""The folder of a calibration: its photos, kept as the camera gave them, a journal with their hashes, and what follows from them.

::

    DIR/journal.jsonl            one line a photo: what was shown, when, which file and hash; append only
    DIR/photos/PART/0000.jpg     PART is what was measured: response, poses
    DIR/response.json, .html     what `rig calibrate response` found, and its report page
    DIR/calibration.json         what `rig calibrate poses` found; `rig capture` takes it over

As in a session, a photo is whole on the disk before its journal line is written.
"""

import hashlib
from pathlib import Path
from types import TracebackType

from drivers.protocols import Photo
from recon.calibration.calibration_file import UsedPhoto
from recon.sessions.disk import Disk, make_folders, write_fault, write_whole
from recon.sessions.journal import JOURNAL_NAME, JournalWriter
from rig.errors import CaptureError

EVENT = "calibration_photo"


class CalibrationFolder:
    """Keeps the photos of one part of a calibration; ``photos`` are those of this run."""

    def __init__(self, folder: Path, part: str) -> None:
        self.folder = folder
        self._part = part
        self._disk = Disk()
        self._photos_folder = folder / "photos" / part
        if self._photos_folder.exists():
            raise CaptureError(
                f"{self._photos_folder}: is there already, and photos are never overwritten; choose a new folder"
            )
        try:
            make_folders(self._photos_folder, disk=self._disk)
        except OSError as error:
            raise CaptureError(write_fault(self._photos_folder, error)) from error
        self._journal = JournalWriter(folder / JOURNAL_NAME, disk=self._disk)
        self.photos: list[UsedPhoto] = []

    def save(self, files: tuple[Photo, ...], *, shows: str, **facts: object) -> None:
        """Write the files of one photo, then a journal line for each; all are on disk when this returns."""
        number = len(self.photos)
        for file in files:
            path = self._photos_folder / f"{number:04d}{file.suffix.lower()}"
            try:
                write_whole(path, file.data, disk=self._disk)
            except OSError as error:
                raise CaptureError(write_fault(path, error)) from error
            digest = hashlib.sha256(file.data).hexdigest()
            relative = path.relative_to(self.folder).as_posix()
            self._journal.append(EVENT, part=self._part, file=relative, sha256=digest, shows=shows, **facts)
            self.photos.append(UsedPhoto(file=relative, sha256=digest, shows=shows))

    def __enter__(self) -> "CalibrationFolder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._journal.close()
