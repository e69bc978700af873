"""Hashes of the files that a run starts from: by them anybody can tell whether a result is of these very files."""

import hashlib
from pathlib import Path

from recon.calibration.calibration_file import CALIBRATION_NAME
from recon.calibration.response_record import RESPONSE_NAME
from recon.sessions.journal import JOURNAL_NAME
from recon.sessions.session import MANIFEST_NAME


def input_hashes(session: Path, *, calibration: Path | None) -> dict[str, str]:
    """Return the SHA-256 of manifest, journal (which holds those of the photos), response and calibration, by name.

    Without a ``calibration`` the session's own counts, if it has one. Raises ``OSError`` for a file that cannot be read.
    """
    files = {name: session / name for name in (MANIFEST_NAME, JOURNAL_NAME)}
    if (session / RESPONSE_NAME).is_file():
        files[RESPONSE_NAME] = session / RESPONSE_NAME
    own = session / CALIBRATION_NAME
    if calibration is not None or own.is_file():
        files[CALIBRATION_NAME] = calibration or own
    return {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
