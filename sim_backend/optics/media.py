"""Refractive index: by wavelength for glasses and water, and by place for glass that is not homogeneous."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Vectors = Float64[np.ndarray, "rays 3"]
Numbers = Float64[np.ndarray, " rays"]

# Sellmeier coefficients B and C (µm²) from Schott's optical glass data sheets.
GLASSES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "N-BK7": ((1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)),
    "N-SF11": ((1.73759695, 0.313747346, 1.89878101), (0.013188707, 0.0623068142, 155.23629)),
    "fused silica": ((0.6961663, 0.4079426, 0.8974794), (0.0684043**2, 0.1162414**2, 9.896161**2)),
}

# Water at 20 °C: wavelength in nm, index.
WATER_20C = ((465.0, 1.3387), (530.0, 1.3355), (620.0, 1.3325))

# The middle of each primary of a display, and its weight in a grey photo (Rec. 601 luma).
PRIMARY_NM = {"red": 620.0, "green": 530.0, "blue": 465.0}
GREY_WEIGHT = {"red": 0.299, "green": 0.587, "blue": 0.114}


def sellmeier_index(glass: str, wavelength_nm: float) -> float:
    """Return a glass's index: n² = 1 + Σ B λ² / (λ² − C), λ in µm."""
    strengths, resonances = GLASSES[glass]
    square = (wavelength_nm / 1000) ** 2
    return float(np.sqrt(1 + sum(b * square / (square - c) for b, c in zip(strengths, resonances, strict=True))))


def water_index(wavelength_nm: float) -> float:
    """Return the index of water at 20 °C: Cauchy's A + B / λ² + C / λ⁴ through the three tabulated colours."""
    table = np.array(WATER_20C)
    powers = np.stack([(table[:, 0] / 1000) ** -exponent for exponent in (0.0, 2.0, 4.0)], axis=1)
    a, b, c = np.linalg.solve(powers, table[:, 1])
    square = (wavelength_nm / 1000) ** -2
    return float(a + b * square + c * square * square)


@dataclass(frozen=True, slots=True)
class IndexVariation:
    """How an index varies with place: n + ``axial_per_mm`` z + ``radial_per_mm2`` (x² + y²).

    Rays are bent in steps of ``step_mm``; the error of a path falls with the square of the step.
    """

    axial_per_mm: float
    radial_per_mm2: float
    step_mm: float

    def added(self, points: Vectors) -> Numbers:
        """Return what comes on top of the body's index."""
        return self.axial_per_mm * points[:, 2] + self.radial_per_mm2 * np.sum(points[:, :2] ** 2, axis=1)

    def gradient(self, points: Vectors) -> Vectors:
        """Return the gradient of the index."""
        slopes = np.full_like(points, self.axial_per_mm)
        slopes[:, :2] = 2 * self.radial_per_mm2 * points[:, :2]
        return slopes
