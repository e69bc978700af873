"""A glass wedge whose far face ripples or steps, in water over a tablet: the scenes of the study of resolution, in millimetres.

The face leans by 20° so that the light paths in air and in liquid part by about 8°: over a face at right angles to the sight they
would be parallel. Display, liquid and the camera's distance are those of the twin of the hemisphere.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.study.simulator import Scene

LEAN_DEG = 20.0
AMPLITUDE_MM = 0.05
STEP_MM = 0.5
N_OBJECT = 1.5195
CAMERA_DISTANCE_MM = 420.0
FOCAL_PX = 2100.0
# A 9.7-inch tablet: 2,048 columns over 197 mm. The stage holds it 30 and 70 mm beyond the middle of the face.
DISPLAY_COLUMNS, DISPLAY_ROWS, PITCH_MM = 2048, 1536, 0.0962
CLEARANCES_MM = (30.0, 70.0)
# As with a slanted edge (ISO 12233), no column of pixels runs along ripples or step, so that all phases within a pixel are seen.
ROLL_DEG = 5.0
# The wedge leaves so much of the photo's width free, and counts so far out from its middle.
WEDGE_SHARE, JUDGED_SHARE = 0.9, 0.8

PerPixel = Float64[np.ndarray, "rows cols"]


@dataclass(frozen=True, slots=True)
class Wedge:
    """Sizes of the wedge that fills a photo of so many columns."""

    columns: int

    @property
    def side_mm(self) -> float:
        """Length of its edges in x and y."""
        return WEDGE_SHARE * self.columns * CAMERA_DISTANCE_MM / FOCAL_PX

    @property
    def thickness_mm(self) -> float:
        """Thickness in the middle: 1.5 mm more than a sharp edge asks for."""
        return self.side_mm / 2 * self.slope + 1.5

    @property
    def slope(self) -> float:
        """Rise of the far face along y."""
        return float(np.tan(np.radians(LEAN_DEG)))

    @property
    def footprint_mm(self) -> float:
        """Spacing of neighbouring pixels on the middle of the far face: the glass before it appears as thick as t / n."""
        return (CAMERA_DISTANCE_MM + self.thickness_mm / N_OBJECT) / FOCAL_PX

    def height_mm(self, point_mm: Float64[np.ndarray, "rows cols 3"]) -> PerPixel:
        """Return how far points lie beyond the leaning plane, along z."""
        return point_mm[..., 2] - self.thickness_mm - self.slope * point_mm[..., 1]


def rippled_wedge(wedge: Wedge, *, wavelength_mm: float) -> Scene:
    """Return the wedge with ripples of 0.05 mm along x."""
    shape = {"kind": "wedge_rippled", "amplitude_mm": AMPLITUDE_MM, "wavelength_mm": wavelength_mm}
    return _scene(wedge, "rippled_wedge", shape)


def stepped_wedge(wedge: Wedge) -> Scene:
    """Return the wedge whose far face steps by 0.5 mm at x = 0."""
    return _scene(wedge, "stepped_wedge", {"kind": "wedge_stepped", "step_mm": STEP_MM})


def _scene(wedge: Wedge, name: str, shape: dict[str, object]) -> Scene:
    centre_px = (wedge.columns - 1) / 2
    cosine, sine = np.cos(np.radians(ROLL_DEG)), np.sin(np.radians(ROLL_DEG))
    return {
        "name": name,
        "method": "liquid",
        "n_object": N_OBJECT,
        "n_liquid": 1.3355,
        "liquid": "water",
        "liquid_level_mm": 0.5,
        "stage_positions_mm": [wedge.thickness_mm + clearance for clearance in CLEARANCES_MM],
        "specimen": {"side_mm": wedge.side_mm, "thickness_mm": wedge.thickness_mm, "lean_deg": LEAN_DEG, **shape},
        "display": {"columns": DISPLAY_COLUMNS, "rows": DISPLAY_ROWS, "pitch_mm": PITCH_MM},
        "camera": {
            "columns": wedge.columns,
            "rows": wedge.columns,
            "position_mm": [0.0, 0.0, -CAMERA_DISTANCE_MM],
            "x_axis": [float(cosine), float(sine), 0.0],
            "y_axis": [float(-sine), float(cosine), 0.0],
            "focal_x_px": FOCAL_PX,
            "focal_y_px": FOCAL_PX,
            "centre_x_px": centre_px,
            "centre_y_px": centre_px,
        },
    }
