"""What was measured of a display's behaviour, on disk: ``response.json``, schema version 1.

This module is the only place that parses one. A part that could not be measured is absent, and ``left_out`` says why.
"""

import json
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError

from recon.bad_value import first_fault
from recon.calibration.brightness_drift import BrightnessDrift
from recon.calibration.calibration_file import UsedPhoto
from recon.calibration.errors import CalibrationError
from recon.calibration.flicker import Bands, Flicker, Swing
from recon.calibration.latency import Latency
from recon.calibration.level_response import LevelResponse
from recon.calibration.primary_planes import PrimaryPlanes
from recon.sessions.disk import Disk, write_fault, write_whole
from recon.sessions.manifest import DeviceRecord, DisplayPanel, Finite, Part, Positive

RESPONSE_NAME = "response.json"
RESPONSE_VERSION = 1
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Numbers = tuple[Finite, ...]


class LevelRecord(Part):
    """Photo values (counts) of drive levels; ``light_table`` is 0 to 1 for each of the 256 levels."""

    level: Numbers
    value: Numbers
    value_sd: Numbers
    full_scale: Positive
    gamma: Positive
    gamma_sd: NotNegative
    black: Finite
    black_sd: NotNegative
    white: Finite
    white_sd: NotNegative
    residual_rms: NotNegative
    model_rms: NotNegative
    clipped_from: Finite | None
    light_table: Numbers


class LatencyRecord(Part):
    """From the command to half of the change of light; ``acknowledged_s`` is when the display said that it was done."""

    after_s: Numbers
    share: Numbers
    exposure_s: Positive
    latency_s: Finite
    latency_sd_s: NotNegative
    rise_s: NotNegative
    rise_sd_s: NotNegative
    share_rms: NotNegative
    settled_s: Finite
    readout_s: NotNegative = 0.0
    readout_sd_s: NotNegative = 0.0
    spread_s: NotNegative = 0.0
    acknowledged_s: Finite


class FlickerRecord(Part):
    """Swing of the brightness at each shutter time, and the flicker that explains it; no frequency where none was found."""

    exposure_s: Numbers
    swing: Numbers
    swing_sd: Numbers
    frequency_hz: Positive | None
    frequency_sd_hz: NotNegative | None
    depth: NotNegative
    depth_sd: NotNegative
    bands_per_photo: Finite | None = None
    safe_times: tuple[str, ...] = ()


class DriftRecord(Part):
    """Brightness of one frame over time, as a share of its mean."""

    time_s: Numbers
    relative: Numbers
    per_min: Finite
    per_min_sd: NotNegative


class PlanesRecord(Part):
    """Light in the planes blue, green and red as shares of the strongest."""

    share: Numbers
    sd: Numbers
    grey: bool


class ResponseRecord(Part):
    """All that was measured of a display's behaviour, with which devices and settings, and from which photos."""

    schema_version: Literal[1]
    name: str
    created: str
    display: DisplayPanel
    settings: dict[str, str] = Field(default_factory=dict)
    levels: LevelRecord | None = None
    latency: LatencyRecord | None = None
    flicker: FlickerRecord | None = None
    drift: DriftRecord | None = None
    planes: PlanesRecord | None = None
    warnings: tuple[str, ...] = ()
    left_out: dict[str, str] = Field(default_factory=dict)
    software: dict[str, str] = Field(default_factory=dict)
    devices: dict[str, DeviceRecord] = Field(default_factory=dict)
    photos: tuple[UsedPhoto, ...] = ()


def level_record(found: LevelResponse) -> LevelRecord:
    """Return the response as the file holds it."""
    return LevelRecord(
        level=_numbers(found.level),
        value=_numbers(found.value),
        value_sd=_numbers(found.value_sd),
        full_scale=found.full_scale,
        gamma=found.gamma,
        gamma_sd=found.gamma_sd,
        black=found.black,
        black_sd=found.black_sd,
        white=found.white,
        white_sd=found.white_sd,
        residual_rms=found.residual_rms,
        model_rms=found.model_rms,
        clipped_from=found.clipped_from,
        light_table=_numbers(found.light_table()),
    )


def latency_record(found: Latency, *, acknowledged_s: float) -> LatencyRecord:
    """Return the latency as the file holds it."""
    return LatencyRecord(
        after_s=_numbers(found.after_s),
        share=_numbers(found.share),
        exposure_s=found.exposure_s,
        latency_s=found.latency_s,
        latency_sd_s=found.latency_sd_s,
        rise_s=found.rise_s,
        rise_sd_s=found.rise_sd_s,
        share_rms=found.share_rms,
        settled_s=found.settled_s,
        readout_s=found.readout_s,
        readout_sd_s=found.readout_sd_s,
        spread_s=found.spread_s,
        acknowledged_s=acknowledged_s,
    )


def flicker_record(
    found: Flicker, swings: tuple[Swing, ...], *, bands: Bands | None, safe: tuple[str, ...]
) -> FlickerRecord:
    """Return the flicker as the file holds it."""
    return FlickerRecord(
        exposure_s=tuple(each.exposure_s for each in swings),
        swing=tuple(each.swing for each in swings),
        swing_sd=tuple(each.sd for each in swings),
        frequency_hz=found.frequency_hz if found.found else None,
        frequency_sd_hz=found.frequency_sd_hz if found.found else None,
        depth=found.depth,
        depth_sd=found.depth_sd,
        bands_per_photo=bands.per_photo if bands else None,
        safe_times=safe,
    )


def drift_record(found: BrightnessDrift) -> DriftRecord:
    """Return the drift as the file holds it."""
    return DriftRecord(
        time_s=_numbers(found.time_s),
        relative=_numbers(found.relative),
        per_min=found.per_min,
        per_min_sd=found.per_min_sd,
    )


def planes_record(found: PrimaryPlanes) -> PlanesRecord:
    """Return the colour planes as the file holds them."""
    return PlanesRecord(share=_numbers(found.share), sd=_numbers(found.sd), grey=found.grey)


def read_response(path: Path) -> ResponseRecord:
    """Read a response, or say in one sentence why that cannot be done."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such response; make one with `rig calibrate response`") from None
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{path}: cannot be read ({error}); measure again") from None
    version = data.get("schema_version") if isinstance(data, dict) else None
    if version != RESPONSE_VERSION:
        raise CalibrationError(
            f"{path}: schema_version is {version!r}, this program reads {RESPONSE_VERSION}; measure again"
        )
    try:
        return ResponseRecord.model_validate(data)
    except ValidationError as error:
        raise CalibrationError(f"{path}: {first_fault(error, whole='response')}; measure again") from None


def write_response(path: Path, response: ResponseRecord, *, disk: Disk | None = None) -> None:
    """Write a response so that it is whole or absent."""
    try:
        write_whole(path, (response.model_dump_json(indent=1) + "\n").encode(), disk=disk or Disk())
    except OSError as error:
        raise CalibrationError(write_fault(path, error)) from error


def _numbers(values: np.ndarray) -> Numbers:
    return tuple(float(each) for each in values)
