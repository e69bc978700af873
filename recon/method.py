"""What a reconstruction may be asked for: its method, the tests that a point must pass, and how normals become a surface."""

import math
from dataclasses import dataclass
from typing import Literal

Method = Literal["paper", "full"]
# How the normals of a thin object become a surface.
ThinForm = Literal["fused", "quadratic", "discrete", "bilateral"]


@dataclass(frozen=True, slots=True)
class Limits:
    """The tests that a point must pass. Angles in rad; lengths in mm; the sigmas are in standard deviations.

    The paper's method uses the first two, ``full`` the others: its thresholds follow from each pixel's own uncertainty.
    """

    smallest_angle_rad: float = math.radians(1.0)
    largest_gap_share: float = 0.1  # of the distance between the two display positions
    gap_sigma: float = 5.0
    angle_sigma: float = 10.0  # the angle between the paths in units of its sd: 10 % error in depth
