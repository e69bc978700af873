"""A capture's calibration: the measured poses, lens, pitch and cover glass in place of the configured ones, said where from."""

import hashlib
from pathlib import Path

from recon.calibration.calibration_file import calibrated, read_calibration
from recon.calibration.response_record import RESPONSE_NAME, read_response
from recon.calibration.validity import accepted
from recon.errors import SessionError
from recon.sessions.disk import Disk, write_fault, write_whole
from recon.sessions.manifest import Manifest

PROVENANCE = "calibration"


def with_calibration_of(manifest: Manifest, file: str | None) -> tuple[Manifest, tuple[str, ...]]:
    """Return the manifest of a capture with the calibration ``file`` taken over, and a sentence for each doubt about it.

    Which file it was, its hash and its date stand in the manifest's provenance; so does the display's response, where
    ``response.json`` lies beside it.

    Raises
    ------
    CalibrationError
        Where the calibration cannot be read, or is not of this rig.
    """
    if file is None:
        return manifest, ()
    path = Path(file)
    calibration = read_calibration(path)
    warnings = [f"{path}: {text}" for text in (*accepted(calibration, manifest, source=file), *calibration.warnings)]
    source: dict[str, object] = {"file": file, "sha256": digest(path), "created": calibration.created}
    response_path = path.with_name(RESPONSE_NAME)
    if response_path.is_file():
        response = read_response(response_path)
        source["response"] = {
            "file": str(response_path),
            "sha256": digest(response_path),
            "created": response.created,
            "gamma": response.levels.gamma if response.levels else None,
            "latency_s": response.latency.latency_s if response.latency else None,
            "flicker_hz": response.flicker.frequency_hz if response.flicker else None,
        }
        warnings += [
            f"{response_path}: {text}" for text in changed_settings(response.settings, manifest.camera.settings)
        ]
    taken_over = calibrated(manifest, calibration)
    configuration = {**manifest.provenance.configuration, PROVENANCE: source}
    provenance = manifest.provenance.model_copy(update={"configuration": configuration})
    return taken_over.model_copy(update={"provenance": provenance}), tuple(warnings)


def keep_response(folder: Path, file: str | None) -> None:
    """Copy the ``response.json`` beside the calibration ``file`` into a session, whose fringes are read with it.

    It is copied before the first photo, and again on resuming where a power cut came between.
    """
    source = Path(file).with_name(RESPONSE_NAME) if file is not None else None
    target = folder / RESPONSE_NAME
    if source is None or target.exists() or not source.is_file():
        return
    try:
        write_whole(target, source.read_bytes(), disk=Disk())
    except OSError as error:
        raise SessionError(write_fault(target, error)) from error


def changed_settings(measured: dict[str, str], now: dict[str, str]) -> list[str]:
    """Return a sentence for each camera setting that is not the one of the response."""
    return [
        f"the response was measured with {name} {value}, this capture has {now[name]}; measure it again with "
        "`rig calibrate response`"
        for name, value in measured.items()
        if name in now and now[name] != value
    ]


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
