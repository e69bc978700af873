"""Where something flat stands in the world: the display, the camera, and the flat face of an object."""

import math

import numpy as np
from pydantic import model_validator

from recon.sessions.pattern import Finite, Part

Vector = tuple[Finite, Finite, Finite]

# Unit vectors written by hand carry three or four digits.
AXIS_TOLERANCE = 1e-3


class Pose(Part):
    """Where a flat screen (or the camera) stands: its centre and the directions of its x and y axes."""

    centre_mm: Vector
    x_axis: Vector
    y_axis: Vector

    @model_validator(mode="after")
    def _axes_are_orthonormal(self) -> "Pose":
        for name, axis in (("x_axis", self.x_axis), ("y_axis", self.y_axis)):
            length = math.hypot(*axis)  # of whatever is written there, without a warning of numpy's
            if abs(length - 1) > AXIS_TOLERANCE:
                raise ValueError(f"{name} has length {length:.5g}, it must be 1")
        if abs(float(np.dot(self.x_axis, self.y_axis))) > AXIS_TOLERANCE:
            raise ValueError("x_axis and y_axis must be at right angles")
        return self

    def world_from_screen(self) -> np.ndarray:
        """Return the 4 by 4 matrix that takes screen coordinates (x, y, 0) in mm to the world.

        The third column, x × y, points away from the viewer: into the screen, or forward from the camera.
        """
        x = np.array(self.x_axis) / np.linalg.norm(self.x_axis)
        z = np.cross(x, self.y_axis)
        z /= np.linalg.norm(z)
        world_from_screen = np.eye(4)
        world_from_screen[:3, :4] = np.column_stack([x, np.cross(z, x), z, self.centre_mm])
        return world_from_screen


class FlatFace(Part):
    """A flat face of the object towards the camera: a point on it and its normal, in the world; which way it points is free."""

    point_mm: Vector
    normal: Vector

    @model_validator(mode="after")
    def _normal_has_a_direction(self) -> "FlatFace":
        if not any(self.normal):
            raise ValueError("normal must not be nought")
        return self
