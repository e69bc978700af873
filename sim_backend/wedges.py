"""Glass wedges with fine structure on the face towards the display: what a reconstruction resolves."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_backend.optics.relief import Relief, Ripples
from sim_backend.optics.shapes import half_space
from sim_backend.optics.solids import Solid, intersection, union
from sim_backend.optics.tracer import Body
from sim_backend.specimen_part import Length, SpecimenPart


class RippledWedge(SpecimenPart):
    """A square glass wedge, flat towards the camera at z = 0; its face towards the display leans along y and ripples along x.

    That face is z = thickness + y tan(lean) + amplitude sin(2πx / wavelength), over |x|, |y| ≤ side / 2.
    """

    kind: Literal["wedge_rippled"] = "wedge_rippled"
    side_mm: Length
    thickness_mm: Length
    lean_deg: Annotated[float, Field(ge=0, le=45)]
    amplitude_mm: Length
    wavelength_mm: Length

    @model_validator(mode="after")
    def _is_glass_everywhere(self) -> "RippledWedge":
        _check_thickness(self.thickness_mm, self.side_mm, self.lean_deg, self.amplitude_mm)
        return self

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        slope = float(np.tan(np.radians(self.lean_deg)))
        face = Relief(Ripples(self.thickness_mm, self.amplitude_mm, self.wavelength_mm, slope))
        return (Body(intersection(*_column(self.side_mm), half_space((0, 0, 0), (0, 0, -1)), face), n_object),)


class SteppedWedge(SpecimenPart):
    """A square glass wedge, flat towards the camera at z = 0; its face towards the display leans along y and steps up at x = 0.

    That face is z = thickness + y tan(lean) ± step / 2, the upper half at x > 0, with an upright wall between the halves.
    """

    kind: Literal["wedge_stepped"] = "wedge_stepped"
    side_mm: Length
    thickness_mm: Length
    lean_deg: Annotated[float, Field(ge=0, le=45)]
    step_mm: Length

    @model_validator(mode="after")
    def _is_glass_everywhere(self) -> "SteppedWedge":
        _check_thickness(self.thickness_mm, self.side_mm, self.lean_deg, self.step_mm / 2)
        return self

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        outward = (0.0, -float(np.tan(np.radians(self.lean_deg))), 1.0)
        lower, upper = (
            half_space((0, 0, self.thickness_mm + change), outward) for change in (-self.step_mm / 2, self.step_mm / 2)
        )
        face = union(lower, intersection(upper, half_space((0, 0, 0), (-1, 0, 0))))
        return (Body(intersection(*_column(self.side_mm), half_space((0, 0, 0), (0, 0, -1)), face), n_object),)


def _check_thickness(thickness_mm: float, side_mm: float, lean_deg: float, below_mm: float) -> None:
    needed_mm = side_mm / 2 * float(np.tan(np.radians(lean_deg))) + below_mm
    if thickness_mm <= needed_mm:
        raise ValueError(
            f"thickness_mm is {thickness_mm:g}, and the wedge's thin side would be at {thickness_mm - needed_mm:.3g}; "
            f"give more than {needed_mm:.4g}"
        )


def _column(side_mm: float) -> tuple[Solid, ...]:
    """Return the four half-spaces |x| ≤ side / 2, |y| ≤ side / 2."""
    half = side_mm / 2
    return (
        half_space((half, 0, 0), (1, 0, 0)),
        half_space((-half, 0, 0), (-1, 0, 0)),
        half_space((0, half, 0), (0, 1, 0)),
        half_space((0, -half, 0), (0, -1, 0)),
    )
