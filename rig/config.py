"""The configuration of a rig: a TOML file for a person, a frozen tree of values for the program.

This module is the only place of ``rig`` that parses a configuration; past it, values are trusted. ``rig init`` writes
a file with every value, its unit and its meaning (``template.toml``). Parts that a session's manifest also holds are
the manifest's own classes, so that a value means the same in both.
"""

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from recon.bad_value import reason_of
from recon.patterns.coarse_scan import scan_bits
from recon.patterns.frame_tag import TagPlace
from recon.sessions.manifest import (
    Axis,
    CameraBody,
    DisplayPanel,
    Finite,
    Index,
    Liquid,
    Part,
    Pose,
    Positive,
    ScannedObject,
)
from recon.sessions.pattern import Pattern, StripePattern
from rig.capture_sections import (
    AutoExposure,
    BoardPhotos,
    Calibrate,
    GrayLineCode,
    Live,
    PhaseShiftCode,
    Scan,
    Stripe,
    SweptArea,
    VisualRays,
    Watch,
)
from rig.errors import ConfigError
from rig.planning.coded_pattern import coded_pattern

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
DEFAULT_FILE = Path("rig.toml")
# A sweep of the paper has 3,000; a hundred times as many take a week, and are a slip of the pen.
MOST_PLACES = 300_000
# A pump may run this much longer than its calibrated rate says before its own time limit ends the flow.
PUMP_TIME_MARGIN = 1.2


class FrameTag(Part):
    """The frame's number on the display: device pixel of its top-left corner, side of one of its 12 × 12 cells.

    ``seen_px`` is the part of the photos (first column, first row, last column, last row) in which the camera sees it,
    directly and in all four sets; without it the tag is shown and not read.
    """

    column: Annotated[int, Field(ge=0)]
    row: Annotated[int, Field(ge=0)]
    cell_px: Annotated[int, Field(gt=0)]
    seen_px: tuple[NotNegative, NotNegative, NotNegative, NotNegative] | None = None

    @property
    def place(self) -> TagPlace:
        """Where the tag is on the display."""
        return TagPlace(column=self.column, row=self.row, cell_px=self.cell_px)


class Capture(Part):
    """What is photographed, and in which order the four sets come."""

    order: Literal["one_fill", "paper"] = "one_fill"
    stripe: Stripe
    code: Annotated[GrayLineCode | PhaseShiftCode, Field(discriminator="kind")] | None = None
    swept: SweptArea
    scan: Scan | None = None
    auto_exposure: AutoExposure | None = None
    board: BoardPhotos | None = None
    visual_rays: VisualRays | None = None


class Tank(Part):
    """The tank, its reservoir and its pump. ``fill_ml`` immerses the display side of the object.

    ``reservoir_capacity_ml`` is what the reservoir can hold; without it, no more than was in it, ``reservoir_ml``.
    """

    free_volume_ml: Positive
    fill_ml: Positive
    reservoir_ml: Positive
    reservoir_capacity_ml: Positive | None = None
    has_pump: bool
    pump_rate_ml_per_min: Positive
    drain_at_end: bool

    @model_validator(mode="after")
    def _cannot_overflow(self) -> Self:
        if self.fill_ml > self.free_volume_ml:
            raise ValueError(
                f"fill_ml is {self.fill_ml:g}, the tank's free_volume_ml is {self.free_volume_ml:g}; fill less"
            )
        if self.reservoir_ml > self.free_volume_ml:
            raise ValueError(
                f"reservoir_ml is {self.reservoir_ml:g}, more than the tank's free_volume_ml of "
                f"{self.free_volume_ml:g}: a pump that does not stop would flood the room; put less into the reservoir"
            )
        if self.reservoir_ml < self.fill_ml:
            raise ValueError(
                f"reservoir_ml is {self.reservoir_ml:g}, less than fill_ml of {self.fill_ml:g}; "
                "put more into the reservoir"
            )
        if self.reservoir_can_hold_ml < self.reservoir_ml:
            raise ValueError(
                f"reservoir_capacity_ml is {self.reservoir_can_hold_ml:g}, less than reservoir_ml of "
                f"{self.reservoir_ml:g}, which is in it; correct one of them"
            )
        return self

    @property
    def reservoir_can_hold_ml(self) -> float:
        """How much fits into the reservoir, as far as anybody has said."""
        return self.reservoir_ml if self.reservoir_capacity_ml is None else self.reservoir_capacity_ml


class StageTravel(Part):
    """The linear stage: where position 0 and position 1 are, how far it may go and how fast it is.

    ``microstep_mm`` is what one microstep moves, for drivers that count in them.
    """

    position_0_mm: Finite
    position_1_mm: Finite
    travel_mm: tuple[Finite, Finite]
    velocity_mm_per_s: Positive
    microstep_mm: Positive | None = None

    @model_validator(mode="after")
    def _positions_lie_within_travel(self) -> Self:
        low_mm, high_mm = self.travel_mm
        for name, position_mm in (("position_0_mm", self.position_0_mm), ("position_1_mm", self.position_1_mm)):
            if not low_mm <= position_mm <= high_mm:
                raise ValueError(f"{name} is {position_mm:g}, travel_mm is {low_mm:g} to {high_mm:g}")
        if self.position_0_mm == self.position_1_mm:
            raise ValueError(f"position_0_mm and position_1_mm are both {self.position_0_mm:g}; they must differ")
        return self

    def position_mm(self, position: Literal[0, 1]) -> float:
        """Return where display position 0 or 1 is on the stage."""
        return self.position_1_mm if position else self.position_0_mm


class Timing(Part):
    """How long things take, and how long to let them come to rest."""

    photo_s: Positive
    settle_s: NotNegative
    still_after_move_s: NotNegative
    still_after_fill_s: NotNegative
    photo_mb: Positive
    longest_suspension_s: Positive = 3600.0


class PumpDriver(Part):
    """What the driver of a real pump needs beside its rate, which stands in the section [tank].

    ``diameter_mm``, ``mode``, ``dead_man_s`` and ``pump_number`` belong to New Era pumps, ``drain_rate_ml_per_min`` and
    ``level_points`` (counts of the level sensor, ml in the tank) to a tank board.
    """

    baud: Annotated[int, Field(gt=0)] | None = None
    diameter_mm: Positive | None = None
    mode: Literal["safe", "basic"] = "safe"
    dead_man_s: Annotated[int, Field(ge=1, le=255)] = 5
    pump_number: Annotated[int, Field(ge=0, le=99)] = 0
    drain_rate_ml_per_min: Positive | None = None
    level_points: tuple[tuple[NotNegative, NotNegative], ...] = ()

    @model_validator(mode="after")
    def _level_can_be_interpolated(self) -> Self:
        counts = [point[0] for point in self.level_points]
        if len(counts) == 1 or len(set(counts)) < len(counts):
            raise ValueError("level_points needs two or more pairs of counts and ml, each count once")
        return self


class DeviceAddresses(Part):
    """Driver and address of each real device, such as ``grbl:/dev/ttyUSB0``; empty where there is none.

    ``camera_profile`` is the kind of camera; empty to choose by the model that answers.
    """

    camera: str = ""
    camera_profile: str = ""
    display: str = ""
    stage: str = ""
    pump: str = ""


class RigConfig(Part):
    """Everything a capture needs to know."""

    name: Annotated[str, Field(min_length=1)]
    method: Literal["liquid", "thin"]
    length_unit: Literal["mm", "scene unit"] = "mm"
    object: ScannedObject
    n_air: Index
    liquid: Liquid | None = None
    display: DisplayPanel
    display_poses: tuple[Pose, Pose]
    calibration: str | None = None
    calibrate: Calibrate = Calibrate()
    camera: CameraBody
    capture: Capture
    tank: Tank | None = None
    pump: PumpDriver = PumpDriver()
    stage: StageTravel
    timing: Timing
    frame_tag: FrameTag | None = None
    live: Live | None = None
    watch: Watch | None = None
    devices: DeviceAddresses = DeviceAddresses()

    @model_validator(mode="after")
    def _method_has_what_it_needs(self) -> Self:
        if self.method == "liquid" and (self.liquid is None or self.tank is None):
            missing = "liquid" if self.liquid is None else "tank"
            raise ValueError(f"method 'liquid' needs the section [{missing}]; add it, or choose method 'thin'")
        if self.method == "thin" and self.object.n is None:
            raise ValueError("method 'thin' needs the object's refractive index (n in section [object])")
        if self.capture.board is not None:
            self.capture.board.check(self.display, method=self.method)
        if self.capture.visual_rays is not None:
            self.capture.visual_rays.check(self.camera, self.calibration, method=self.method)
        return self

    @model_validator(mode="after")
    def _sweep_stays_on_the_panel(self) -> Self:
        for axis in ("x", "y"):
            self.pattern(axis)
        if self.capture.code is not None and self.capture.scan is not None:
            raise ValueError(
                "section [capture.scan] saves photos of a sweep; a code has few: leave out [capture.scan] or [capture.code]"
            )
        return self

    @model_validator(mode="after")
    def _what_counts_lies_in_the_photo(self) -> Self:
        for name, section in (("scan", self.capture.scan), ("auto_exposure", self.capture.auto_exposure)):
            if section is None or section.seen_px is None:
                continue
            left, top, right, bottom = section.seen_px
            if not (left < right < self.camera.columns and top < bottom < self.camera.rows):
                raise ValueError(
                    f"capture.{name}.seen_px is {list(section.seen_px)}; give first column, first row, last column and last "
                    f"row within photos of {self.camera.columns} × {self.camera.rows}"
                )
        return self

    @model_validator(mode="after")
    def _tag_stays_clear_of_the_stripe(self) -> Self:
        tag = self.frame_tag
        if tag is None:
            return self
        side_px = tag.place.side_px
        if tag.column + side_px > self.display.columns or tag.row + side_px > self.display.rows:
            raise ValueError(
                f"the frame tag takes {side_px} × {side_px} device pixels from column {tag.column}, row {tag.row}; the "
                f"display has {self.display.columns} × {self.display.rows}"
            )
        swept, reach_px = self.capture.swept, self.capture.stripe.width_px / 2
        columns = (swept.first_column_px - reach_px, swept.last_column_px + reach_px)
        rows = (swept.first_row_px - reach_px, swept.last_row_px + reach_px)
        if tag.place.covers(columns=columns, rows=rows):
            raise ValueError(
                f"the frame tag (columns {tag.column} to {tag.column + side_px - 1}, rows {tag.row} to "
                f"{tag.row + side_px - 1}) lies in the swept area with its stripes; move it, or sweep less"
            )
        if tag.seen_px is not None:
            left, top, right, bottom = tag.seen_px
            if not (left < right <= self.camera.columns - 1 and top < bottom <= self.camera.rows - 1):
                raise ValueError(
                    f"frame_tag.seen_px is {list(tag.seen_px)}; give first column, first row, last column and last row "
                    f"within photos of {self.camera.columns} × {self.camera.rows}"
                )
        return self

    def device_px(self, axis: Axis) -> int:
        """Return how many device pixels the display has along ``axis``."""
        return self.display.columns if axis == "x" else self.display.rows

    def scan_bits(self, axis: Axis) -> int:
        """Return how many photos the scan along ``axis`` takes in each set; 0 without a scan."""
        return scan_bits(self.stripe_pattern(axis)) if self.capture.scan else 0

    def pattern(self, axis: Axis) -> Pattern:
        """Return what the display shows in the sweep along ``axis``."""
        try:
            return coded_pattern(self.stripe_pattern(axis), self.capture.code)
        except ValidationError as error:
            reason = reason_of(error.errors()[0])
            raise ValueError(
                f"the code of section [capture.code] does not go with [capture.stripe]: {reason}"
            ) from None

    def stripe_pattern(self, axis: Axis) -> StripePattern:
        """Return the stripe swept along ``axis`` without a code; the last place may fall short by less than a step."""
        stripe, swept = self.capture.stripe, self.capture.swept
        noun = "column" if axis == "x" else "row"
        first_px = swept.first_column_px if axis == "x" else swept.first_row_px
        last_px = swept.last_column_px if axis == "x" else swept.last_row_px
        if last_px > self.device_px(axis) - 1:
            raise ValueError(f"last_{noun}_px is {last_px:g}, the display's last {noun} is {self.device_px(axis) - 1}")
        if stripe.width_px >= self.device_px(axis):
            raise ValueError(
                f"the stripe is width_px {stripe.width_px:g} wide, the display has {self.device_px(axis)} {noun}s; a stripe that "
                "fills the display tells no place, make it a few pixels wide"
            )
        # A step of 0.1 does not add up exactly; a thousandth of a step keeps the last place.
        count = math.floor(min((last_px - first_px) / stripe.step_px + 1e-3, MOST_PLACES)) + 1
        if not 3 <= count <= MOST_PLACES:
            limit = "needs at least 3" if count < 3 else f"may have {MOST_PLACES} at most"
            found = max(count, 0) if count <= MOST_PLACES else f"more than {MOST_PLACES}"
            raise ValueError(
                f"the stripe takes {found} places from first_{noun}_px {first_px:g} to last_{noun}_px "
                f"{last_px:g} with step_px {stripe.step_px:g}; a sweep {limit}"
            )
        return StripePattern(
            profile=stripe.profile, width_px=stripe.width_px, first_px=first_px, step_px=stripe.step_px, count=count
        )


def longest_run_s(volume_ml: float, tank: Tank) -> float:
    """Return the longest time that the pump may run to move ``volume_ml``."""
    return PUMP_TIME_MARGIN * volume_ml / tank.pump_rate_ml_per_min * 60


def load_config(path: Path) -> RigConfig:
    """Read a configuration, or say in one sentence what is wrong with its first bad value and on which line."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; write one with `rig init {path}`, or rehearse with --sim") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None
    if isinstance(data.get("calibration"), str):
        data["calibration"] = str(path.parent / data["calibration"])  # an absolute one stays as it is
    try:
        return RigConfig.model_validate(data)
    except ValidationError as error:
        raise ConfigError(first_fault(error, source=str(path), text=text)) from None


def parse_config(data: Mapping[str, object], *, source: str) -> RigConfig:
    """Build a configuration from values that did not come from a file, with the same one-sentence errors."""
    try:
        return RigConfig.model_validate(data)
    except ValidationError as error:
        raise ConfigError(first_fault(error, source=source)) from None


def first_fault(error: ValidationError, *, source: str, text: str = "") -> str:
    """Say what is wrong first: file, line where it can be found, key, and the reason."""
    fault = error.errors()[0]
    keys = [str(part) for part in fault["loc"]]
    line = line_of(text, keys)
    parts = [f"{source}, line {line}" if line else source, ".".join(keys), reason_of(fault)]
    return ": ".join(part for part in parts if part)


def line_of(text: str, keys: list[str]) -> int | None:
    """Return the line where the TOML key ``keys`` stands, or that of the nearest table that holds it."""
    table: list[str] = []
    tables_of: dict[str, int] = {}
    best: tuple[int, int] | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.strip()
        if content.startswith("["):
            name = content.split("]")[0].lstrip("[")
            table = [part.strip() for part in name.split(".")]
            if content.startswith("[["):
                tables_of[name] = tables_of.get(name, -1) + 1
                table.append(str(tables_of[name]))
            path = table
        elif "=" in content and not content.startswith("#"):
            path = table + [part.strip() for part in content.split("=")[0].split(".")]
        else:
            continue
        if path == keys[: len(path)] and (best is None or len(path) > best[0]):
            best = (len(path), number)
    return best[1] if best else None
