"""A scene: the object, the tank, the display and the camera that the simulator pretends to have.

Frame: right-handed, x right, y down, z away from the camera. Lengths are millimetres; in a scene whose
``length_unit`` is "scene unit", one unit stands for one millimetre. Built-in scenes are the TOML files in ``scenes/``;
any file of the same shape is a scene too.
"""

import tomllib
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from sim_backend.optics.media import GLASSES, GREY_WEIGHT, PRIMARY_NM, IndexVariation, sellmeier_index, water_index
from sim_backend.optics.screen import ScreenPose
from sim_backend.optics.shapes import half_space, sphere
from sim_backend.optics.tracer import Body, OpticalWorld
from sim_backend.scene_parts import (
    Finite,
    Index,
    SceneCamera,
    SceneDisplay,
    SceneFlicker,
    SceneGlass,
    SceneMarks,
    ScenePart,
    SceneVariation,
    SuggestedStripe,
    Tank,
    WhenFilled,
)
from sim_backend.specimens import Specimen

__all__ = [
    "Scene",
    "SceneCamera",
    "SceneDisplay",
    "SceneError",
    "SceneFlicker",
    "SceneGlass",
    "SceneMarks",
    "SceneVariation",
    "SpectralLine",
    "SuggestedStripe",
    "Tank",
    "WhenFilled",
    "load_scene",
    "scene_names",
]


class SceneError(ValueError):
    """A scene that does not exist or cannot be read; the message is one sentence for the user."""


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """One colour of the display's light: its share of a grey photo, and the indices it meets."""

    weight: float
    n_object: float
    n_liquid: float | None


class Scene(ScenePart):
    """Everything the simulator needs to know; see the module's docstring for frame and units.

    ``glass`` names a glass of :mod:`sim_backend.optics.media` and makes the scene disperse light: ``n_object`` is then the
    glass's index at the display's primary (green, for a white display), water has the index of each colour too, and a
    white display sends three colours on paths of their own. Without ``glass`` light has one colour.
    """

    name: str
    note: str = ""
    method: Literal["liquid", "thin"]
    length_unit: Literal["mm", "scene unit"] = "mm"
    specimen: Specimen
    glass: str | None = None
    n_object: Index
    index_variation: SceneVariation | None = None
    n_air: Index = 1.0
    n_liquid: Index | None = None
    liquid: str = "water"
    liquid_level_mm: Finite | None = None
    when_filled: WhenFilled | None = None
    fresnel: bool = True
    display: SceneDisplay
    stage_positions_mm: tuple[Finite, Finite]
    camera: SceneCamera
    marks: SceneMarks | None = None
    tank: Tank = Tank()
    stripe: SuggestedStripe = SuggestedStripe()
    seed: Annotated[int, Field(ge=0)] = 1

    @model_validator(mode="before")
    @classmethod
    def _index_of_the_glass(cls, given: object) -> object:
        """Fill in the indices that follow from the glass and the colour."""
        if not isinstance(given, dict) or given.get("glass") is None:
            return given
        if given["glass"] not in GLASSES:
            raise ValueError(f"glass {given['glass']!r} is not one of {', '.join(GLASSES)}")
        panel = given.get("display")
        primary = panel.get("primary", "white") if isinstance(panel, dict) else getattr(panel, "primary", "white")
        wavelength_nm = PRIMARY_NM.get(primary, PRIMARY_NM["green"])
        filled = {"n_object": sellmeier_index(given["glass"], wavelength_nm)}
        if given.get("method") == "liquid" and given.get("liquid", "water") == "water":
            filled["n_liquid"] = water_index(wavelength_nm)
        for name, value in filled.items():
            if abs(given.get(name, value) - value) > 1e-9:
                raise ValueError(f"{name} follows from glass {given['glass']!r} and the primary; leave one of them out")
        return {**given, **filled}

    @model_validator(mode="after")
    def _liquid_is_described(self) -> "Scene":
        if self.method == "liquid" and (self.n_liquid is None or self.liquid_level_mm is None):
            raise ValueError("method 'liquid' needs n_liquid and liquid_level_mm")
        if self.method == "thin" and self.when_filled is not None:
            raise ValueError("when_filled belongs to the method 'liquid': no tank is filled for a thin object")
        return self

    @model_validator(mode="after")
    def _axes_are_orthonormal(self) -> "Scene":
        for owner, x_axis, y_axis in (
            ("display", self.display.x_axis, self.display.y_axis),
            ("camera", self.camera.x_axis, self.camera.y_axis),
        ):
            x, y = np.array(x_axis), np.array(y_axis)
            if abs(x @ x - 1) > 1e-6 or abs(y @ y - 1) > 1e-6 or abs(x @ y) > 1e-6:
                raise ValueError(f"the {owner}'s x_axis and y_axis must have length 1 and be at right angles")
        return self

    def display_pose_at(self, stage_position_mm: float) -> ScreenPose:
        """Return where the plane of the display's pixels stands when the stage is at this position."""
        panel = self.display
        centre = np.array(panel.centre_mm) + stage_position_mm * np.array(panel.stage_direction)
        return ScreenPose(centre, np.array(panel.x_axis), np.array(panel.y_axis))

    def object_shift_mm(self, *, wet: bool) -> tuple[float, float, float]:
        """Return how far filling the tank has moved the object."""
        return self.when_filled.object_shift_mm if wet and self.when_filled is not None else (0.0, 0.0, 0.0)

    def undisturbed(self) -> "Scene":
        """Return the scene in which filling the tank changes nothing but the medium."""
        return self.model_copy(update={"when_filled": None})

    def spectrum(self) -> tuple[SpectralLine, ...]:
        """Return the colours that a photo adds up; their weights sum to 1."""
        if self.glass is None or self.display.primary != "white":
            return (SpectralLine(1.0, self.n_object, self.n_liquid),)
        lines = []
        for primary, wavelength_nm in PRIMARY_NM.items():
            disperses = self.liquid == "water" and self.n_liquid is not None
            n_liquid = water_index(wavelength_nm) if disperses else self.n_liquid
            lines.append(SpectralLine(GREY_WEIGHT[primary], sellmeier_index(self.glass, wavelength_nm), n_liquid))
        return tuple(lines)

    def world(self, *, wet: bool, object_present: bool = True, line: SpectralLine | None = None) -> OpticalWorld:
        """Return the bodies that light of one colour meets: liquid if ``wet``, then the object.

        Without ``line``, the light is that of ``n_object`` and ``n_liquid``. The frame is the object's own: where filling the
        tank has moved it (:meth:`object_shift_mm`), the liquid's level moves the other way.
        """
        colour = line or SpectralLine(1.0, self.n_object, self.n_liquid)
        bodies: tuple[Body, ...] = ()
        if wet:
            if colour.n_liquid is None or self.liquid_level_mm is None:
                raise SceneError(f"scene {self.name!r} has no liquid, so it cannot be photographed wet")
            rise_mm = self.object_shift_mm(wet=True)[2] if object_present else 0.0
            surface = half_space((0, 0, self.liquid_level_mm - rise_mm), (0, 0, -1))
            bodies += (Body(surface, colour.n_liquid, of_object=False),)
            if self.when_filled is not None and object_present:
                bodies += tuple(
                    Body(sphere((x, y, z), radius), self.n_air, of_object=False)
                    for x, y, z, radius in self.when_filled.bubbles_mm
                )
        if object_present:
            bodies += self._pieces(colour.n_object)
        return OpticalWorld(bodies, self.n_air)

    def _pieces(self, n_object: float) -> tuple[Body, ...]:
        """Return the object's bodies; those that are not full of air vary if the scene's glass does."""
        pieces = self.specimen.bodies(n_object=n_object, n_air=self.n_air)
        if self.index_variation is None:
            return pieces
        variation = IndexVariation(**self.index_variation.model_dump())
        return tuple(replace(piece, variation=variation) if piece.n == n_object else piece for piece in pieces)

    def resized(self, *, camera_columns: int | None = None, display_columns: int | None = None) -> "Scene":
        """Return the same scene with more or fewer pixels over the same field and the same panel."""
        changes: dict[str, object] = {}
        if camera_columns is not None:
            changes["camera"] = _resized_camera(self.camera, camera_columns)
        if display_columns is not None:
            scale = display_columns / self.display.columns
            changes["display"] = self.display.model_copy(
                update={
                    "columns": display_columns,
                    "rows": max(1, round(self.display.rows * scale)),
                    "pitch_mm": self.display.pitch_mm / scale,
                }
            )
        return self.model_copy(update=changes)


def _resized_camera(camera: SceneCamera, columns: int) -> SceneCamera:
    """Scale a camera's pixels about the corner of the sensor, so that the field stays the same."""
    scale = columns / camera.columns
    return camera.model_copy(
        update={
            "columns": columns,
            "rows": max(1, round(camera.rows * scale)),
            "focal_x_px": camera.focal_x_px * scale,
            "focal_y_px": camera.focal_y_px * scale,
            "centre_x_px": (camera.centre_x_px + 0.5) * scale - 0.5,
            "centre_y_px": (camera.centre_y_px + 0.5) * scale - 0.5,
            "blur_px": camera.blur_px * scale,
        }
    )


def scene_names() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    folder = resources.files("sim_backend") / "scenes"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def load_scene(name_or_path: str | Path) -> Scene:
    """Return a built-in scene by name, or the scene that a TOML file describes.

    Raises
    ------
    SceneError
        If there is no such scene, or the file is not one; the message names the field, or lists the built-in scenes.
    """
    if str(name_or_path) in scene_names():
        text = (resources.files("sim_backend") / "scenes" / f"{name_or_path}.toml").read_text("utf-8")
    else:
        path = Path(name_or_path)
        if not path.is_file():
            raise SceneError(
                f"no scene {str(name_or_path)!r}: choose one of {', '.join(scene_names())}, or give a TOML file"
            )
        text = path.read_text("utf-8")
    try:
        return Scene.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"scene {str(name_or_path)!r} is not TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise SceneError(f"scene {str(name_or_path)!r}, {place or 'as a whole'}: {first['msg']}") from error
