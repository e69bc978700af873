"""The manifest of a session, schema version 1: what was photographed, with what, and where it stood.

This module is the only place that parses a manifest. ``docs/reference/session-format.md`` describes the same fields in
words. Lengths are millimetres, angles degrees only where a name says so; axes are unit vectors in the frame of the
display poses (right-handed).
"""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from recon.errors import ReconError

# Those named twice are part of a manifest's vocabulary, and other modules take them from here.
from recon.sessions.pattern import Finite as Finite
from recon.sessions.pattern import GrayLinePattern as GrayLinePattern
from recon.sessions.pattern import Part as Part
from recon.sessions.pattern import Pattern as Pattern
from recon.sessions.pattern import PhaseShiftPattern as PhaseShiftPattern
from recon.sessions.pattern import Positive as Positive
from recon.sessions.pattern import StripePattern as StripePattern
from recon.sessions.pose import FlatFace as FlatFace
from recon.sessions.pose import Pose as Pose

SCHEMA_VERSION = 1

Index = Annotated[float, Field(ge=1.0, le=4.0, allow_inf_nan=False)]
Axis = Literal["x", "y"]
Condition = Literal["air", "liquid", "with", "without"]


class ScannedObject(Part):
    """The transparent object. Index and flat face are needed only for the thin-object method."""

    name: str
    n: Index | None = None
    flat_face: FlatFace | None = None
    note: str = ""


class Liquid(Part):
    """What the tank is filled with, and its refractive index at the colour of the stripe.

    Without ``n``, water has that of ``temperature_c``, and any other liquid the one that the session itself shows.
    """

    name: str = "water"
    n: Index | None = None
    temperature_c: Finite | None = None


class CoverGlass(Part):
    """A plane sheet between the display's pixels and the tank."""

    thickness_mm: Positive
    n: Index


class DisplayPanel(Part):
    """The display: device pixels, their pitch, and what covers them.

    ``continuous`` says that the stripe was drawn as a smooth function of place, as a renderer does; a real display shows it in
    steps of one device pixel.
    """

    columns: Annotated[int, Field(gt=0)]
    rows: Annotated[int, Field(gt=0)]
    pitch_mm: Positive
    primary: Literal["white", "red", "green", "blue"] = "white"
    cover_glass: CoverGlass | None = None
    continuous: bool = False


class DisplayedBoard(Part):
    """The ChArUco board that photos named ``board`` show: its squares in device pixels of the display.

    ``first_column`` and ``first_row`` are the device pixel of its top-left corner. ``layout`` is ``new`` where the top-left
    square is black, as OpenCV draws boards since 4.6, ``legacy`` where it is white (for an even number of rows).
    """

    squares_x: Annotated[int, Field(ge=3)]
    squares_y: Annotated[int, Field(ge=3)]
    square_px: Annotated[int, Field(gt=0)]
    first_column: Annotated[int, Field(ge=0)]
    first_row: Annotated[int, Field(ge=0)]
    marker_share: Annotated[float, Field(gt=0, lt=1)] = 0.6
    dictionary: str = "DICT_5X5_250"
    layout: Literal["new", "legacy"] = "new"


class Intrinsics(Part):
    """Pinhole camera in pixels with OpenCV's distortion (k1, k2, p1, p2, k3)."""

    focal_x_px: Positive
    focal_y_px: Positive
    centre_x_px: Finite
    centre_y_px: Finite
    distortion: tuple[Finite, ...] = ()


class CameraBody(Part):
    """The camera: the size of its photos, and where it stands if that is known."""

    columns: Annotated[int, Field(gt=0)]
    rows: Annotated[int, Field(gt=0)]
    model: str = ""
    pose: Pose | None = None
    intrinsics: Intrinsics | None = None
    settings: dict[str, str] = Field(default_factory=dict)


class Sweep(Part):
    """One pattern shown along one axis; its photos are ``photos/<set>/<axis>/NNNN.<suffix>``."""

    axis: Axis
    pattern: Pattern


class CaptureSet(Part):
    """One place of the display in one condition, with a sweep along x and one along y.

    ``pose`` replaces the pose of the position where the display was measured again for this set.
    """

    position: Literal[0, 1]
    condition: Condition
    sweeps: tuple[Sweep, Sweep]
    pose: Pose | None = None

    @property
    def name(self) -> str:
        """Folder and journal name, such as ``pos0_air``."""
        return f"pos{self.position}_{self.condition}"

    @model_validator(mode="after")
    def _one_sweep_an_axis(self) -> "CaptureSet":
        if {sweep.axis for sweep in self.sweeps} != {"x", "y"}:
            raise ValueError("a set needs one sweep along x and one along y")
        return self

    def sweep(self, axis: Axis) -> Sweep:
        """Return the sweep along ``axis``."""
        return next(sweep for sweep in self.sweeps if sweep.axis == axis)


class DeviceRecord(Part):
    """Which device took part, and whether it was real."""

    kind: Literal["real", "simulated", "emulated", "unknown"]
    model: str = ""
    address: str = ""
    version: str = ""


class Provenance(Part):
    """Where the session comes from: software versions, devices, configuration, and a word of explanation."""

    software: dict[str, str] = Field(default_factory=dict)
    devices: dict[str, DeviceRecord] = Field(default_factory=dict)
    configuration: dict[str, object] = Field(default_factory=dict)
    note: str = ""


class Manifest(Part):
    """All that a session's photos mean."""

    schema_version: Literal[1]
    name: str
    created: str
    method: Literal["liquid", "thin"]
    object: ScannedObject
    n_air: Index = 1.0
    liquid: Liquid | None = None
    length_unit: Literal["mm", "scene unit"] = "mm"
    display: DisplayPanel
    display_poses: tuple[Pose, Pose]
    camera: CameraBody
    sets: tuple[CaptureSet, ...]
    mask: str | None = None
    board: DisplayedBoard | None = None
    provenance: Provenance = Provenance()

    @model_validator(mode="after")
    def _sets_of_the_method(self) -> "Manifest":
        conditions = ("air", "liquid") if self.method == "liquid" else ("without", "with")
        wanted = sorted(f"pos{position}_{condition}" for position in (0, 1) for condition in conditions)
        found = sorted(capture_set.name for capture_set in self.sets)
        if found != wanted and (self.method == "liquid" or found != ["pos0_with", "pos1_with"]):
            raise ValueError(f"method {self.method!r} needs the sets {wanted}, found {found}")
        if self.method == "liquid" and self.liquid is None:
            raise ValueError("method 'liquid' needs the liquid and its index")
        if self.method == "thin" and self.object.n is None:
            raise ValueError("method 'thin' needs the object's index (object.n)")
        return self

    @model_validator(mode="after")
    def _poses_differ(self) -> "Manifest":
        first, second = (pose.centre_mm for pose in self.display_poses)
        if math.dist(first, second) < self.display.pitch_mm:
            raise ValueError(
                "the two display positions coincide (less than one display pixel apart); "
                "the display must stand at two places"
            )
        return self

    @property
    def visual_rays_from_camera(self) -> bool:
        """Whether a thin object was photographed with the object alone, so that lens and pose of the camera give its rays."""
        return self.method == "thin" and len(self.sets) == 2

    def set_named(self, name: str) -> CaptureSet:
        """Return the capture set with this name."""
        return next(capture_set for capture_set in self.sets if capture_set.name == name)

    def n_liquid(self) -> float:
        """Return the liquid's index; ``recon.media.liquid_index`` finds one for a manifest that states none."""
        if self.liquid is None or self.liquid.n is None:
            raise ReconError("the manifest does not state the liquid's index (liquid.n)")
        return self.liquid.n

    def pose_of(self, capture_set: CaptureSet) -> Pose:
        """Return where the display stood in this set."""
        return capture_set.pose or self.display_poses[capture_set.position]
