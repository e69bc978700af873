"""The parts of a scene: display, camera, tank, stripe and glass, as a scene file describes them."""

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Count = Annotated[int, Field(gt=0)]
Index = Annotated[float, Field(ge=1.0, le=4.0)]
Vector = tuple[Finite, Finite, Finite]


class ScenePart(BaseModel):
    """Common behaviour of every part of a scene: unchangeable, and no field that we do not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class SceneGlass(ScenePart):
    """A plane sheet over the display's pixels."""

    thickness_mm: Positive
    n: Index


class SceneFlicker(ScenePart):
    """How the display's brightness swings about its mean: by ``depth`` of it up and down, as a sine or from one to the other."""

    frequency_hz: Positive
    depth: Annotated[float, Field(gt=0, le=1)]
    wave: Literal["sine", "square"] = "sine"


class SceneDisplay(ScenePart):
    """The panel: its pixels, how drive level turns into light, and where its pixel plane stands at stage position 0.

    Light is ``(level / 255) ** gamma``, from 0 to 1. The stage carries the panel along ``stage_direction``. ``latency_s`` passes
    from the command to show a frame until its light; a display that says it is done may say so earlier. ``drift_per_min`` is the
    share of its brightness that the display gains each minute, from the start of the world's clock.
    """

    columns: Count
    rows: Count
    pitch_mm: Positive
    gamma: Positive = 1.0
    primary: Literal["white", "red", "green", "blue"] = "white"
    cover_glass: SceneGlass | None = None
    centre_mm: Vector = (0.0, 0.0, 0.0)
    x_axis: Vector = (1.0, 0.0, 0.0)
    y_axis: Vector = (0.0, 1.0, 0.0)
    stage_direction: Vector = (0.0, 0.0, 1.0)
    latency_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    flicker: SceneFlicker | None = None
    drift_per_min: Finite = 0.0

    @property
    def changes_with_time(self) -> bool:
        """Whether it matters when a photo is taken, and for how long."""
        return self.latency_s > 0 or self.flicker is not None or self.drift_per_min != 0


class SceneCamera(ScenePart):
    """The camera: where it stands, its lens, and what its sensor adds.

    A pixel that sees a fully lit display without loss has ``ambient + signal`` of full scale, a dark one ``ambient``.
    ``full_well_electrons`` is full scale. The photo's grey level is 255 · value ^ (1 / response_gamma).

    With a ``global`` shutter all rows see the same time; with a ``rolling`` one, row r of n opens r / n · ``readout_s`` after the
    first and closes as much later. It shows where the display changes with time (:class:`SceneDisplay`).
    """

    columns: Count
    rows: Count
    position_mm: Vector
    x_axis: Vector = (1.0, 0.0, 0.0)
    y_axis: Vector = (0.0, 1.0, 0.0)
    focal_x_px: Positive
    focal_y_px: Positive
    centre_x_px: Finite
    centre_y_px: Finite
    distortion: tuple[Finite, ...] = ()
    supersampling: Annotated[int, Field(ge=1, le=8)] = 2
    blur_px: Annotated[float, Field(ge=0)] = 0.0
    full_well_electrons: Positive = 20000.0
    read_noise_electrons: Annotated[float, Field(ge=0)] = 12.0
    signal: Annotated[float, Field(gt=0, le=2)] = 0.9
    ambient: Annotated[float, Field(ge=0, le=1)] = 0.01
    response_gamma: Positive = 1.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 95
    shutter: Literal["global", "rolling"] = "global"
    readout_s: Annotated[float, Field(ge=0, le=1)] = 0.0

    @model_validator(mode="after")
    def _only_a_rolling_shutter_reads_out_row_by_row(self) -> "SceneCamera":
        if (self.shutter == "rolling") != (self.readout_s > 0):
            raise ValueError("readout_s belongs to the shutter 'rolling', which needs it; a global shutter has none")
        return self

    def world_from_camera(self) -> np.ndarray:
        """Return the 3 by 3 matrix whose columns are the camera's x, y and forward axes."""
        x, y = np.array(self.x_axis), np.array(self.y_axis)
        return np.column_stack([x, y, np.cross(x, y)])


class Tank(ScenePart):
    """How much liquid the tank takes, and how much of it raises the level from dry to wet."""

    free_volume_ml: Positive = 6000.0
    fill_ml: Positive = 4000.0


class WhenFilled(ScenePart):
    """What filling the tank changes beside the liquid, in the wet sets only; neither manifest nor truth know of it.

    ``object_shift_mm`` (x, y, z) moves the object on its holder, as buoyancy does. ``bubbles_mm`` are balls of air that sit on
    the object and move with it: centre where the object stands dry, and radius; what the object fills of a ball is glass.
    ``display_bubbles_mm`` are balls that touch the display's glass and move with the stage: place along the panel's own x
    and y from its middle, and radius.
    """

    object_shift_mm: Vector = (0.0, 0.0, 0.0)
    bubbles_mm: tuple[tuple[Finite, Finite, Finite, Positive], ...] = ()
    display_bubbles_mm: tuple[tuple[Finite, Finite, Positive], ...] = ()


class SuggestedStripe(ScenePart):
    """The stripe that suits the scene, in device pixels."""

    profile: Literal["hard", "raised_cosine"] = "raised_cosine"
    width_px: Positive = 6.0
    step_px: Positive = 1.0


class SceneVariation(ScenePart):
    """Glass whose index varies with place: n_object + axial_per_mm · z + radial_per_mm2 · (x² + y²)."""

    axial_per_mm: Finite = 0.0
    radial_per_mm2: Finite = 0.0
    step_mm: Positive = 0.1


class SceneMarks(ScenePart):
    """Square printed marks with rings, in a plane z = ``height_mm`` above the liquid, on the object's holder or the tank's rim.

    ``radius_mm`` is that of the outer ring and half the square's side; ``light`` the share of full scale that their white sends
    to the camera: room light, not the display's.
    """

    centres_mm: tuple[tuple[Finite, Finite], ...]
    height_mm: Finite
    radius_mm: Positive
    light: Annotated[float, Field(gt=0, le=1)] = 0.5
    fixed_to: Literal["holder", "rim"] = "holder"
