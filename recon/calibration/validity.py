"""Whether a calibration may be used for a session: one sentence for each doubt, and whether it refuses or warns."""

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

from recon.calibration.calibration_file import Calibration
from recon.calibration.errors import CalibrationError
from recon.sessions.manifest import Manifest

# A setting whose name has one of these words moves the lens's rays; shutter time and sensitivity do not.
LENS_WORDS = ("aperture", "f-number", "fnumber", "focus", "focal", "zoom", "lens")
PITCH_SHARE = 0.01
S_A_DAY = 86400.0


@dataclass(frozen=True, slots=True)
class Doubt:
    """One thing that does not fit: ``refuse`` where results would be wrong, ``warn`` where they may be."""

    severity: Literal["refuse", "warn"]
    text: str


def doubts(calibration: Calibration, manifest: Manifest) -> tuple[Doubt, ...]:
    """Return all that speaks against using a calibration for the session of a manifest."""
    return (*_other_devices(calibration, manifest), *_age(calibration, manifest), *_settings(calibration, manifest))


def accepted(calibration: Calibration, manifest: Manifest, *, source: str) -> tuple[str, ...]:
    """Return the warnings, or raise the first refusal as a ``CalibrationError``."""
    found = doubts(calibration, manifest)
    for doubt in found:
        if doubt.severity == "refuse":
            raise CalibrationError(f"{source}: {doubt.text}")
    return tuple(doubt.text for doubt in found)


def _other_devices(calibration: Calibration, manifest: Manifest) -> list[Doubt]:
    found = []
    for what, made, used in (
        ("photos", calibration.camera, manifest.camera),
        ("display", calibration.display, manifest.display),
    ):
        if (made.columns, made.rows) != (used.columns, used.rows):
            found.append(
                Doubt(
                    "refuse",
                    f"the calibration's {what} have {made.columns} x {made.rows} px, the session's {used.columns} x {used.rows}; "
                    "calibrate with the same devices and the same photo size",
                )
            )
    if manifest.length_unit != "mm":
        found.append(
            Doubt("refuse", "the calibration is in mm, the session in scene units; give the session's own poses")
        )
    share = calibration.display.pitch_mm / manifest.display.pitch_mm - 1
    if abs(share) > PITCH_SHARE:
        found.append(
            Doubt(
                "refuse",
                f"the calibration's display has a pitch of {calibration.display.pitch_mm:g} mm, the session's "
                f"{manifest.display.pitch_mm:g} mm; this is another display",
            )
        )
    if calibration.camera.model and manifest.camera.model and calibration.camera.model != manifest.camera.model:
        found.append(
            Doubt(
                "refuse",
                f"the calibration is of a {calibration.camera.model}, the session of a {manifest.camera.model}; "
                "calibrate the camera that took the session",
            )
        )
    found += _kinds(calibration, manifest)
    return found


def _kinds(calibration: Calibration, manifest: Manifest) -> list[Doubt]:
    """A real session with a simulated calibration is wrong; nothing else about kinds is."""
    camera, calibrating = (one.provenance.devices.get("camera") for one in (manifest, calibration))
    if camera is None or calibrating is None or camera.kind != "real" or calibrating.kind == "real":
        return []
    return [
        Doubt(
            "refuse", f"the calibration's camera was {calibrating.kind}, the session's was real; calibrate the real one"
        )
    ]


def _age(calibration: Calibration, manifest: Manifest) -> list[Doubt]:
    made, used = _moment(calibration.created), _moment(manifest.created)
    if made is None or used is None:
        return [Doubt("warn", "the age of the calibration is not known: its date or the session's is no ISO 8601 date")]
    days = (used - made).total_seconds() / S_A_DAY
    if days > calibration.valid_days:
        return [
            Doubt(
                "warn",
                f"the calibration was {days:.0f} days old when the session began, it holds for {calibration.valid_days:g}; "
                "calibrate again, or look at the gaps in the report",
            )
        ]
    if days < -1:
        return [
            Doubt(
                "warn",
                f"the calibration was made {-days:.0f} days after the session; nothing may have moved in between",
            )
        ]
    return []


def _settings(calibration: Calibration, manifest: Manifest) -> list[Doubt]:
    found = []
    for name, made in calibration.camera.settings.items():
        used = manifest.camera.settings.get(name)
        if used is not None and used != made and any(word in name.lower() for word in LENS_WORDS):
            found.append(
                Doubt(
                    "warn",
                    f"the calibration was made with {name} {made}, the session with {used}; "
                    "the lens images differently, calibrate again",
                )
            )
    return found


def _moment(text: str) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
