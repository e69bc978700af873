"""Sections of the configuration that make a capture shorter or safer: each may be left out."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from recon.calibration.board import board_places
from recon.calibration.errors import CalibrationError
from recon.sessions.manifest import CameraBody, DisplayPanel, Finite, Part, Positive

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
PhotoPixel = Annotated[int, Field(ge=0)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Stripe(Part):
    """The bright stripe: its profile, width and step, in device pixels of the display."""

    profile: Literal["hard", "raised_cosine"]
    width_px: Positive
    step_px: Positive


class SweptArea(Part):
    """Where the stripe's centre goes: first and last device pixel along each axis, both included."""

    first_column_px: NotNegative
    last_column_px: NotNegative
    first_row_px: NotNegative
    last_row_px: NotNegative


class Scan(Part):
    """A few photos at the beginning of each set that find the part of the display that is seen; only that part is swept.

    ``seen_px`` is the part of the photos that counts (first column, first row, last column, last row), such as the object's
    outline; without it every lit pixel counts.
    """

    seen_px: tuple[PhotoPixel, PhotoPixel, PhotoPixel, PhotoPixel] | None = None


class GrayLineCode(Part):
    """Lines a period apart instead of one stripe, with profile, width and step of it, and a Gray code of half periods."""

    kind: Literal["gray_line"]
    period_px: Positive = 16.0


class PhaseShiftCode(Part):
    """Cosine fringes instead of a stripe: ``frequencies`` periods in equal ratios, each in ``steps`` phases."""

    kind: Literal["phase_shift"]
    finest_period_px: Positive = 16.0
    frequencies: Annotated[int, Field(ge=1, le=8)] = 3
    steps: Annotated[int, Field(ge=3, le=64)] = 8


class AutoExposure(Part):
    """The camera's exposure time is chosen before the first set, from what the body offers for ``setting``.

    ``brightest_share`` is how far the white photo may reach into the range of counts: what is left is for the liquid, with
    which photos can be brighter. ``darkest_share`` is where a set is called too dark. ``seen_px`` as in the scan.
    """

    setting: str = "shutterspeed"
    refresh_hz: Positive = 60.0
    brightest_share: Annotated[float, Field(gt=0, lt=1)] = 0.75
    darkest_share: Share = 0.2
    seen_px: tuple[PhotoPixel, PhotoPixel, PhotoPixel, PhotoPixel] | None = None


class BoardPhotos(Part):
    """Photos of a calibration board on the display at the beginning of each set: where the display stood in this very set.

    ``squares_along`` are the squares along the display's longer side, ``photos`` how many are taken in a row.
    """

    squares_along: Annotated[int, Field(ge=3)] = 16
    photos: Annotated[int, Field(ge=1)] = 1

    def check(self, display: DisplayPanel, *, method: str) -> None:
        """Raise ``ValueError`` where the board does not fit the display, or there is no wet set to compare with."""
        if method != "liquid":
            raise ValueError(
                "capture.board belongs to method 'liquid': it tells the display dry from the display wet; leave it out"
            )
        try:
            board_places(display, squares_along=self.squares_along)
        except CalibrationError as error:
            raise ValueError(f"capture.board: {error}") from None


class VisualRays(Part):
    """Where the visual rays of a thin object come from; left out, they are photographed.

    ``photographed``: two more sets, without the object. ``camera``: lens and pose of the calibrated camera give them, and the two
    sets with the object suffice.
    """

    source: Literal["photographed", "camera"]

    def check(self, camera: CameraBody, calibration: str | None, *, method: str) -> None:
        """Raise ``ValueError`` where they are to come from a camera that nothing is known of."""
        if method != "thin":
            raise ValueError("capture.visual_rays belongs to method 'thin'; leave it out")
        if self.source == "camera" and calibration is None and (camera.pose is None or camera.intrinsics is None):
            raise ValueError(
                "capture.visual_rays takes them from the camera: add the sections [camera.pose] and [camera.intrinsics] or a "
                "calibration, or let them be photographed (source = 'photographed')"
            )


class Live(Part):
    """Each sweep is decoded while the next is photographed, and one beyond these limits is photographed again.

    The limits are judgements: good sweeps of the simulated scenes match 94 to 99 % of their lit pixels with contrasts of 0.98,
    a misfit of 2 to 3 for a smooth stripe and of 8 for a hard one.
    """

    least_coverage: Share = 0.7
    largest_saturated_share: Share = 0.05
    least_contrast: Share = 0.3
    largest_misfit: Positive = 30.0
    largest_dark_share: Share = 0.1
    object_distance_mm: Positive | None = None
    largest_entry_sd_mm: Positive | None = None
    attempts: Annotated[int, Field(ge=1)] = 2
    page_port: Annotated[int, Field(ge=0, le=65535)] = 0


class Watch(Part):
    """Reference photos before and after each sweep show whether camera, object, display, light and liquid stayed as they were.

    ``object_px`` outlines the object in the photos, corner by corner (x, y); ``marks_px`` are printed marks, each by its first
    column, first row, last column and last row. ``finest_px`` is the finest detail of the reference frame in device pixels;
    without it, what takes eight of a thousand pixels across the photo.
    """

    shift_px: Positive = 0.05
    sigmas: Positive = 6.0
    light_share: Share = 0.02
    when_moved: Literal["stop", "warn"] = "stop"
    when_light_changed: Literal["retake", "stop", "warn"] = "warn"
    when_liquid_moves: Literal["retake", "stop", "warn"] = "retake"
    attempts: Annotated[int, Field(ge=1)] = 3
    still_photos: Annotated[int, Field(ge=1)] = 3
    longest_wait_s: Positive = 300.0
    object_px: tuple[tuple[Finite, Finite], ...] = ()
    marks_px: tuple[tuple[Finite, Finite, Finite, Finite], ...] = ()
    finest_px: Positive | None = None

    @model_validator(mode="after")
    def _outline_encloses_something(self) -> Self:
        if 0 < len(self.object_px) < 3:
            raise ValueError("object_px needs at least three corners [x, y]; or leave it out")
        for left, top, right, bottom in self.marks_px:
            if not (left < right and top < bottom):
                raise ValueError(
                    f"marks_px holds {[left, top, right, bottom]}; give first column, first row, last column, last row"
                )
        return self


class Calibrate(Part):
    """What `rig calibrate` photographs, and what is known beforehand; each value may be left out.

    ``squares`` and ``square_mm`` are those of a printed board, ``squares_along`` those along the longer side of the display,
    whose board is drawn with levels up to ``white``. ``travel_sd_mm``, ``pitch_sd`` (a share) and ``glass_sd_mm`` say how well
    the stage's way, the display's pitch and its cover glass are known; pitch and glass are estimated only where that is given.
    What the calibration means at an object is told for half a ball of ``object_radius_mm``, ``object_gap_mm`` before the nearer
    position.
    """

    board: Literal["printed", "display"] = "printed"
    squares: tuple[Annotated[int, Field(ge=3)], Annotated[int, Field(ge=3)]] = (9, 6)
    square_mm: Positive | None = None
    dictionary: str = "DICT_5X5_250"
    squares_along: Annotated[int, Field(ge=3)] = 16
    white: Annotated[int, Field(ge=1, le=255)] = 255
    photos: Annotated[int, Field(ge=1)] = 3
    travel_sd_mm: Positive = 0.05
    pitch_sd: Positive | None = None
    glass_sd_mm: Positive | None = None
    object_radius_mm: Positive = 25.0
    object_gap_mm: Positive = 25.0
    valid_days: Positive = 30.0
