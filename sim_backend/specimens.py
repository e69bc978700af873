"""The transparent objects that scenes can hold: their dimensions, and the bodies they are made of.

Every object stands in the scene's frame: x right, y down, z away from the camera, so its display side is at large z.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from sim_backend.optics.relief import Relief, Rings, Scales
from sim_backend.optics.shapes import cone, cylinder, ellipsoid, elliptic_cylinder, half_space, slab, sphere
from sim_backend.optics.solids import Solid, difference, intersection, union
from sim_backend.optics.tracer import Body
from sim_backend.specimen_part import Length, SpecimenPart
from sim_backend.wedges import RippledWedge, SteppedWedge


class SemiEllipsoid(SpecimenPart):
    """Half an ellipsoid, its flat face in the plane z = 0 towards the camera."""

    kind: Literal["semi_ellipsoid"] = "semi_ellipsoid"
    semi_axes_mm: tuple[Length, Length, Length]

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        return (
            Body(intersection(ellipsoid((0, 0, 0), self.semi_axes_mm), half_space((0, 0, 0), (0, 0, -1))), n_object),
        )


class ConcaveCone(SpecimenPart):
    """A cylinder along z that ends at z = 0, less a cone whose apex lies ``cone_height_mm`` inside that end."""

    kind: Literal["concave_cone"] = "concave_cone"
    radius_mm: Length
    height_mm: Length
    cone_height_mm: Length
    cone_radius_mm: Length

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        rod = intersection(cylinder((0, 0, 0), (0, 0, 1), self.radius_mm), *slab(-self.height_mm, 0))
        hollow = cone((0, 0, -self.cone_height_mm), (0, 0, 1), self.cone_radius_mm / self.cone_height_mm)
        return (Body(difference(rod, hollow), n_object),)


class Hemisphere(SpecimenPart):
    """Half a ball, its flat face in the plane z = 0 towards the camera."""

    kind: Literal["hemisphere"] = "hemisphere"
    radius_mm: Length

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        return (Body(intersection(sphere((0, 0, 0), self.radius_mm), half_space((0, 0, 0), (0, 0, -1))), n_object),)


class SlottedHemisphere(SpecimenPart):
    """Half a ball with its flat face in the plane z = 0, sawn into from x > 0 as far as the axis.

    The slot's faces are ``slot_mm`` apart, half-way between them z = ``slot_depth_mm`` on the axis; they rise by
    ``slot_tilt_deg`` from the plane z = const. towards x > 0. It is open: air fills it dry and liquid when wet, so that light on
    that side leaves the glass and enters it again.
    """

    kind: Literal["slotted_hemisphere"] = "slotted_hemisphere"
    radius_mm: Length
    slot_mm: Length
    slot_depth_mm: Length
    slot_tilt_deg: Annotated[float, Field(gt=-45, lt=45)] = 0.0

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        dome = intersection(sphere((0, 0, 0), self.radius_mm), half_space((0, 0, 0), (0, 0, -1)))
        tilt = np.radians(self.slot_tilt_deg)
        across = np.array([-np.sin(tilt), 0.0, np.cos(tilt)])
        middle = np.array([0.0, 0.0, self.slot_depth_mm])
        slot = intersection(
            half_space(middle + 0.5 * self.slot_mm * across, across),
            half_space(middle - 0.5 * self.slot_mm * across, -across),
            half_space((0, 0, 0), (-1, 0, 0)),
        )
        return (Body(difference(dome, slot), n_object),)


class ThinCone(SpecimenPart):
    """A flat cone on the plane z = 0, its apex towards the display, padded by a cylinder on the camera side."""

    kind: Literal["thin_cone"] = "thin_cone"
    height_mm: Length
    radius_mm: Length
    padding_mm: Annotated[float, Field(ge=0)]

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece; cone and padding are one body, without a boundary between them."""
        solid: Solid = intersection(
            cone((0, 0, self.height_mm), (0, 0, -1), self.radius_mm / self.height_mm),
            half_space((0, 0, 0), (0, 0, -1)),
        )
        if self.padding_mm > 0:
            solid = union(
                solid, intersection(cylinder((0, 0, 0), (0, 0, 1), self.radius_mm), *slab(-self.padding_mm, 0))
            )
        return (Body(solid, n_object),)


class ThinShell(SpecimenPart):
    """A ball about the origin less the same ball shifted towards the camera: a crescent that bulges to the display."""

    kind: Literal["thin_shell"] = "thin_shell"
    radius_mm: Length
    shift_mm: Length

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        return (
            Body(
                difference(sphere((0, 0, 0), self.radius_mm), sphere((0, 0, -self.shift_mm), self.radius_mm)), n_object
            ),
        )


class Ornament(SpecimenPart):
    """A convex cut piece: flat towards the camera at z = 0, one plane facet a tilt towards the display.

    Facet i passes ``radius_mm`` from the axis at z = 0, at azimuth 360° i / facets, its normal tilted from z.
    """

    kind: Literal["ornament"] = "ornament"
    radius_mm: Length
    facet_tilts_deg: Annotated[tuple[Annotated[float, Field(gt=0, lt=90)], ...], Field(min_length=3)]

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        azimuths = 2 * np.pi * np.arange(len(self.facet_tilts_deg)) / len(self.facet_tilts_deg)
        facets = []
        for azimuth, tilt in zip(azimuths, np.radians(self.facet_tilts_deg), strict=True):
            outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
            facets.append(half_space(outward * self.radius_mm, (*(np.sin(tilt) * outward[:2]), np.cos(tilt))))
        return (Body(intersection(half_space((0, 0, 0), (0, 0, -1)), *facets), n_object),)


class Bottle(SpecimenPart):
    """A closed hollow cylinder along y about the origin, with air inside."""

    kind: Literal["bottle"] = "bottle"
    radius_mm: Length
    height_mm: Length
    wall_mm: Length

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:
        """Return the glass, and the air that displaces it inside."""
        return (
            Body(_barrel(self.radius_mm, self.height_mm), n_object),
            Body(_barrel(self.radius_mm - self.wall_mm, self.height_mm - 2 * self.wall_mm), n_air),
        )


class RoundPlate(SpecimenPart):
    """A round glass plate, flat towards the camera at z = 0, with concentric rings towards the display."""

    kind: Literal["plate_round"] = "plate_round"
    diameter_mm: Length
    thickness_mm: Length
    relief_mm: Length
    period_mm: Length

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        outline = cylinder((0, 0, 0), (0, 0, 1), self.diameter_mm / 2)
        relief = Relief(Rings(self.thickness_mm, self.relief_mm, self.period_mm))
        return (Body(intersection(outline, half_space((0, 0, 0), (0, 0, -1)), relief), n_object),)


class FishPlate(SpecimenPart):
    """A fish-shaped glass plate, flat towards the camera at z = 0, with scales towards the display.

    The body is an ellipse, the tail a triangle that is as wide as the whole plate; the nose is at −x.
    """

    kind: Literal["plate_fish"] = "plate_fish"
    length_mm: Length
    width_mm: Length
    thickness_mm: Length
    relief_mm: Length
    period_mm: Length

    def bodies(self, *, n_object: float, n_air: float) -> tuple[Body, ...]:  # noqa: ARG002 - one signature
        """Return the solid piece."""
        half_length, half_width = self.length_mm / 2, self.width_mm / 2
        body = elliptic_cylinder((-0.2 * half_length, 0, 0), 0.8 * half_length, 0.75 * half_width)
        # From a point inside the body to the full width at the end.
        fin = (half_width, 0.8 * half_length)
        tip = (0.2 * half_length, 0, 0)
        tail = intersection(
            half_space(tip, (-fin[0], fin[1], 0)),
            half_space(tip, (-fin[0], -fin[1], 0)),
            half_space((half_length, 0, 0), (1, 0, 0)),
        )
        relief = Relief(Scales(self.thickness_mm, self.relief_mm, self.period_mm))
        return (Body(intersection(union(body, tail), half_space((0, 0, 0), (0, 0, -1)), relief), n_object),)


def _barrel(radius_mm: float, height_mm: float) -> Solid:
    """Return a cylinder along y, centred at the origin."""
    return intersection(
        cylinder((0, 0, 0), (0, 1, 0), radius_mm),
        half_space((0, -height_mm / 2, 0), (0, -1, 0)),
        half_space((0, height_mm / 2, 0), (0, 1, 0)),
    )


Specimen = Annotated[
    SemiEllipsoid
    | ConcaveCone
    | Hemisphere
    | SlottedHemisphere
    | ThinCone
    | ThinShell
    | Ornament
    | Bottle
    | RoundPlate
    | FishPlate
    | RippledWedge
    | SteppedWedge,
    Field(discriminator="kind"),
]
