"""A session with its calibration: found beside the manifest or given, checked, and taken over."""

from dataclasses import replace
from pathlib import Path

from recon.calibration.calibration_file import CALIBRATION_NAME, calibrated, read_calibration
from recon.calibration.validity import accepted
from recon.sessions.manifest import Manifest
from recon.sessions.session import MANIFEST_NAME, Session, parse_manifest


def calibration_path(session: Session, given: Path | None) -> Path | None:
    """Return the calibration to use: the one given, else the session's own ``calibration.json``, else None."""
    own = session.folder / CALIBRATION_NAME
    return given or (own if own.is_file() else None)


def with_calibration(session: Session, path: Path) -> tuple[Session, tuple[str, ...]]:
    """Return the session with the measured poses, lens, pitch and cover glass, and what is doubtful about them.

    Raises
    ------
    CalibrationError
        Where the calibration cannot be read, or is not of this session's rig.
    """
    calibration = read_calibration(path)
    doubtful = accepted(calibration, session.manifest, source=str(path))
    warnings = tuple(f"{path.name}: {text}" for text in (*doubtful, *calibration.warnings))
    return replace(session, manifest=calibrated(session.manifest, calibration)), warnings


def calibrated_manifest(folder: Path, path: Path) -> Manifest:
    """Return the manifest on disk, its sweeps whole, with a calibration taken over."""
    source = folder / MANIFEST_NAME
    manifest = parse_manifest(source.read_text(encoding="utf-8"), source=str(source))
    return calibrated(manifest, read_calibration(path))
