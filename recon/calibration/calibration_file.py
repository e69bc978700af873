"""A calibration on disk: ``calibration.json``, schema version 1; what was measured, how well, from which photos, and until when.

This module is the only place that parses one. Poses are in the camera's frame; a session that takes a calibration over
moves them into its own world (:func:`calibrated`).
"""

import json
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float64
from pydantic import Field, ValidationError, model_validator

from recon.bad_value import first_fault
from recon.calibration.bundle import BundleResult
from recon.calibration.display_poses import AIR_PANELS, manifest_pose
from recon.calibration.errors import CalibrationError
from recon.calibration.evidence import Evidence
from recon.calibration.wet_pose import WET_PANELS
from recon.sessions.disk import Disk, write_fault, write_whole
from recon.sessions.manifest import (
    CameraBody,
    CaptureSet,
    DeviceRecord,
    DisplayPanel,
    Finite,
    Index,
    Intrinsics,
    Manifest,
    Part,
    Pose,
    Positive,
)
from recon.sessions.pose import Vector

CALIBRATION_NAME = "calibration.json"
CALIBRATION_VERSION = 1
SetName = Literal["pos0_air", "pos1_air", "pos0_liquid", "pos1_liquid"]
Matrix = tuple[tuple[Finite, ...], ...]
CAMERA_ITSELF = Pose(centre_mm=(0.0, 0.0, 0.0), x_axis=(1.0, 0.0, 0.0), y_axis=(0.0, 1.0, 0.0))


class CalibratedCamera(Part):
    """The lens, with the covariance of (focal x, y, centre x, y, k1, k2, p1, p2, k3), and the settings it was measured with."""

    columns: Annotated[int, Field(gt=0)]
    rows: Annotated[int, Field(gt=0)]
    model: str = ""
    settings: dict[str, str] = Field(default_factory=dict)
    intrinsics: Intrinsics
    covariance: Matrix
    views: Annotated[int, Field(ge=0)] = 0
    rms_px: Annotated[float, Field(ge=0)] = 0.0


class BoardRecord(Part):
    """The board that was shown or printed, and which layout was found."""

    squares_x: int
    squares_y: int
    square_mm: Positive
    dictionary: str
    layout: Literal["new", "legacy", "either"]


class MeasuredLevel(Part):
    """The liquid's surface as the wet photos show it: down · X = distance in the camera's frame."""

    n: Index
    down: Vector
    distance_mm: Positive


class Quality(Part):
    """How good the calibration is: reprojection in px, and what its errors mean for a first entry point (rms).

    ``fep_error_mm`` is told in the camera's frame, ``fep_display_error_mm`` in that of the display at position 0, and
    ``fep_shape_error_mm`` after the motion of the object as a whole is taken off. ``pitch_sd_share`` and
    ``cover_glass_sd_mm`` are there where pitch and glass were measured rather than taken as given.
    """

    reprojection_rms_px: Annotated[float, Field(ge=0)]
    corner_sd_px: Annotated[float, Field(ge=0)]
    corners: Annotated[int, Field(ge=0)] = 0
    corners_dropped: Annotated[int, Field(ge=0)] = 0
    fep_error_mm: Annotated[float, Field(ge=0)] | None = None
    fep_display_error_mm: Annotated[float, Field(ge=0)] | None = None
    fep_shape_error_mm: Annotated[float, Field(ge=0)] | None = None
    normal_error_deg: Annotated[float, Field(ge=0)] | None = None
    pitch_sd_share: Annotated[float, Field(ge=0)] | None = None
    cover_glass_sd_mm: Annotated[float, Field(ge=0)] | None = None


class UsedPhoto(Part):
    """A photo that took part."""

    file: str
    sha256: str
    shows: str = ""


class CalibrationProvenance(Part):
    """Where the calibration comes from: versions, devices, photos, the configuration, and a word of explanation."""

    software: dict[str, str] = Field(default_factory=dict)
    devices: dict[str, DeviceRecord] = Field(default_factory=dict)
    photos: tuple[UsedPhoto, ...] = ()
    configuration: dict[str, object] = Field(default_factory=dict)
    note: str = ""


class Calibration(Part):
    """All that was measured of a rig.

    ``poses`` holds the display's pose in each set that was photographed, in the camera's frame; ``covariance`` is their joint
    one, six numbers a set in the order of ``poses`` (rotation vector about the camera's axes in rad, centre in mm).
    """

    schema_version: Literal[1]
    created: str
    valid_days: Positive = 30.0
    display: DisplayPanel
    camera: CalibratedCamera
    board: BoardRecord | None = None
    poses: dict[SetName, Pose]
    covariance: Matrix = ()
    level: MeasuredLevel | None = None
    quality: Quality
    evidence: Evidence | None = None
    warnings: tuple[str, ...] = ()
    provenance: CalibrationProvenance = CalibrationProvenance()

    @model_validator(mode="after")
    def _both_positions_dry(self) -> "Calibration":
        missing = [name for name in AIR_PANELS if name not in self.poses]
        if missing:
            raise ValueError(f"poses: {' and '.join(missing)} missing; both positions are measured with the tank dry")
        size = 6 * len(self.poses)
        if self.covariance and (len(self.covariance) != size or any(len(row) != size for row in self.covariance)):
            raise ValueError(f"covariance: {size} rows of {size} numbers are needed for {len(self.poses)} poses")
        return self

    def pose_covariance(self) -> Float64[np.ndarray, "numbers numbers"]:
        """Return the joint covariance of the poses as an array; zeros where none is known."""
        size = 6 * len(self.poses)
        return np.array(self.covariance, dtype=np.float64) if self.covariance else np.zeros((size, size))


def measured_poses(result: BundleResult) -> tuple[dict[SetName, Pose], Matrix]:
    """Return the poses of an adjustment and their joint covariance, as the file holds them."""
    names = [name for name in (*AIR_PANELS, *WET_PANELS) if name in result.state.panels]
    poses = {name: manifest_pose(result.state.panels[name]) for name in names}
    return poses, matrix_rows(result.covariance_of(*names))  # type: ignore[return-value]  # the names are those of sets


def matrix_rows(matrix: Float64[np.ndarray, "rows cols"]) -> Matrix:
    """Return a matrix as the file holds it."""
    return tuple(tuple(float(number) for number in row) for row in matrix)


def parse_calibration(text: str, *, source: str) -> Calibration:
    """Read a calibration, or say in one sentence what is wrong with its first bad field."""
    try:
        data = json.loads(text)
    except ValueError as error:
        raise CalibrationError(f"{source}: not JSON ({error}); calibrate again") from None
    version = data.get("schema_version") if isinstance(data, dict) else None
    if version != CALIBRATION_VERSION:
        raise CalibrationError(
            f"{source}: schema_version is {version!r}, this program reads {CALIBRATION_VERSION}; calibrate again"
        )
    try:
        return Calibration.model_validate(data)
    except ValidationError as error:
        raise CalibrationError(f"{source}: {first_fault(error, whole='calibration')}") from None


def read_calibration(path: Path) -> Calibration:
    """Read a calibration from a file, or say in one sentence why that cannot be done."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such calibration; make one with `rig calibrate`") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: cannot be read ({error})") from None
    return parse_calibration(text, source=str(path))


def write_calibration(path: Path, calibration: Calibration, *, disk: Disk | None = None) -> None:
    """Write a calibration so that it is whole or absent."""
    try:
        write_whole(path, (calibration.model_dump_json(indent=1) + "\n").encode(), disk=disk or Disk())
    except OSError as error:
        raise CalibrationError(write_fault(path, error)) from error


def calibrated(manifest: Manifest, calibration: Calibration) -> Manifest:
    """Return the manifest with the measured poses, pitch, cover glass and lens in place of its own.

    The camera stays where the manifest has it; a manifest that does not say gets the camera's frame as its world.
    """
    camera_pose = manifest.camera.pose or CAMERA_ITSELF
    placed = {name: in_world(pose, camera_pose) for name, pose in calibration.poses.items()}
    first, second = (placed[name] for name in AIR_PANELS)  # type: ignore[index]  # these are names of sets
    sets = tuple(_with_pose(one, placed) for one in manifest.sets)
    camera = CameraBody.model_validate(
        manifest.camera.model_dump() | {"pose": camera_pose, "intrinsics": calibration.camera.intrinsics}
    )
    panel = manifest.display.model_copy(
        update={"pitch_mm": calibration.display.pitch_mm, "cover_glass": calibration.display.cover_glass}
    )
    return manifest.model_copy(
        update={"display": panel, "display_poses": (first, second), "camera": camera, "sets": sets}
    )


def in_world(pose: Pose, camera_pose: Pose) -> Pose:
    """Return a pose given in the camera's frame in the world in which the camera has ``camera_pose``."""
    whole = camera_pose.world_from_screen() @ pose.world_from_screen()
    return Pose(centre_mm=tuple(whole[:3, 3]), x_axis=tuple(whole[:3, 0]), y_axis=tuple(whole[:3, 1]))


def _with_pose(capture_set: CaptureSet, placed: dict[SetName, Pose]) -> CaptureSet:
    """Return the set with its own measured pose, if it has one besides that of its position."""
    name = capture_set.name
    if name not in placed:
        return capture_set
    # The pose of a dry set is that of its position.
    return capture_set.model_copy(update={"pose": placed[name] if name in WET_PANELS else None})
