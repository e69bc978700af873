"""A surface with smooth relief on a plane: everything on the camera's side of z = h(x, y)."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from sim_backend.optics.solids import Crossings, Leaf

Vectors = Float64[np.ndarray, "rays 3"]
Numbers = Float64[np.ndarray, " rays"]

# Newton's method squares the error in each step; where a step leaves the bracket, the bracket is halved instead, and so many
# halvings bring any bracket below rounding.
MOST_STEPS = 60
CONVERGED_MM = 1e-12
ON_SURFACE_MM = 1e-10

# Rays flatter than this to the plane may meet a bump twice; they are taken to miss the relief and leave by the rim.
FLATTEST_RAY = 0.3


@dataclass(frozen=True, slots=True)
class Band:
    """Two parallel planes, z = low + slope_y · y and z = high + slope_y · y, with the whole relief between them."""

    low: float
    high: float
    slope_y: float = 0.0


@runtime_checkable
class Heights(Protocol):
    """A smooth height, its slopes, and the planes that it stays between."""

    def band(self) -> Band:
        """Return the planes."""
        ...

    def height(self, x: Numbers, y: Numbers) -> Numbers:
        """Return h(x, y)."""
        ...

    def slopes(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        """Return ∂h/∂x and ∂h/∂y."""
        ...


@dataclass(frozen=True, slots=True)
class Rings:
    """Concentric rings: ``top − depth`` in the middle of a groove, ``top`` on a crest; crests at whole periods."""

    top: float
    depth: float
    period: float

    def band(self) -> Band:
        """Return level planes through crests and grooves."""
        return Band(self.top - self.depth, self.top)

    def height(self, x: Numbers, y: Numbers) -> Numbers:
        """Return top − depth (1 − cos 2πr/p) / 2."""
        return self.top - 0.5 * self.depth * (1 - np.cos(2 * np.pi * np.hypot(x, y) / self.period))

    def slopes(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        """Return the slopes, by way of sin(kr) / r, which is smooth in the middle."""
        wave = 2 * np.pi / self.period
        # numpy's sinc(a) is sin(πa) / (πa).
        factor = -0.5 * self.depth * wave * wave * np.sinc(wave * np.hypot(x, y) / np.pi)
        return factor * x, factor * y


@dataclass(frozen=True, slots=True)
class Scales:
    """Bumps on a triangular grid, like a fish's scales: three plane waves at 0°, 60° and 120°."""

    top: float
    depth: float
    period: float

    def band(self) -> Band:
        """Return level planes through crests and grooves."""
        return Band(self.top - self.depth, self.top)

    def _phases(self, x: Numbers, y: Numbers) -> list[tuple[float, float, Numbers]]:
        wave = 2 * np.pi / self.period
        turns = [(np.cos(angle) * wave, np.sin(angle) * wave) for angle in (0, np.pi / 3, 2 * np.pi / 3)]
        return [(along_x, along_y, along_x * x + along_y * y) for along_x, along_y in turns]

    def height(self, x: Numbers, y: Numbers) -> Numbers:
        """Return top − depth (3 − Σ cos) / 4.5: the sum of the three cosines runs from −1.5 to 3."""
        total = sum(np.cos(phase) for _, _, phase in self._phases(x, y))
        return self.top - self.depth * (3 - total) / 4.5

    def slopes(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        """Return the slopes of the sum of waves."""
        parts = [(along_x, along_y, np.sin(phase)) for along_x, along_y, phase in self._phases(x, y)]
        scale = -self.depth / 4.5
        return (
            scale * sum(along_x * sine for along_x, _, sine in parts),
            scale * sum(along_y * sine for _, along_y, sine in parts),
        )


@dataclass(frozen=True, slots=True)
class Ripples:
    """Straight ripples along x, a sine of zero mean, on a plane that leans along y."""

    middle: float
    amplitude: float
    wavelength: float
    slope_y: float

    def band(self) -> Band:
        """Return the leaning planes through crests and troughs."""
        return Band(self.middle - self.amplitude, self.middle + self.amplitude, self.slope_y)

    def height(self, x: Numbers, y: Numbers) -> Numbers:
        """Return middle + slope_y y + a sin 2πx/Λ."""
        return self.middle + self.slope_y * y + self.amplitude * np.sin(2 * np.pi * x / self.wavelength)

    def slopes(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        """Return the slope of the sine, and the plane's."""
        wave = 2 * np.pi / self.wavelength
        return self.amplitude * wave * np.cos(wave * x), np.full_like(y, self.slope_y)


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """The points with z ≤ h(x, y). A ray meets it once; see ``FLATTEST_RAY`` for those that might not."""

    heights: Heights

    def is_convex(self) -> bool:
        """A relief has valleys."""
        return False

    def leaves(self) -> tuple[Leaf, ...]:
        """Return the surface itself."""
        return (self,)

    def value(self, points: Vectors) -> Numbers:
        """Return the height above the surface."""
        return points[:, 2] - self.heights.height(points[:, 0], points[:, 1])

    def gradient(self, points: Vectors) -> Vectors:
        """Return (−∂h/∂x, −∂h/∂y, 1)."""
        slope_x, slope_y = self.heights.slopes(points[:, 0], points[:, 1])
        return np.stack([-slope_x, -slope_y, np.ones(len(points))], axis=1)

    def crossings(self, origin: Vectors, direction: Vectors) -> Crossings:
        """Find the crossing by Newton's method, kept between the planes that the relief stays between."""
        band = self.heights.band()
        length = np.sqrt(np.einsum("ij,ij->i", direction, direction))
        climb = direction[:, 2] - band.slope_y * direction[:, 1]
        steep = np.abs(climb) > FLATTEST_RAY * np.hypot(1.0, band.slope_y) * length
        rising = np.where(steep, climb, 1.0)
        above_foot = origin[:, 2] - band.slope_y * origin[:, 1]
        # On the low plane a ray is under the relief or on it, on the high one above it or on it.
        under, over = (band.low - above_foot) / rising, (band.high - above_foot) / rising
        distance = 0.5 * (under + over)
        for _ in range(MOST_STEPS):
            points = origin + distance[:, None] * direction
            height = self.value(points)
            if not (steep & (np.abs(height) > CONVERGED_MM)).any():
                break
            under, over = np.where(height <= 0, distance, under), np.where(height > 0, distance, over)
            rate = np.einsum("ij,ij->i", self.gradient(points), direction)
            newton = distance - height / np.where(rate == 0, 1.0, rate)
            within = (newton > np.minimum(under, over)) & (newton < np.maximum(under, over)) & (rate != 0)
            distance = np.where(within, newton, 0.5 * (under + over))
        found = steep & (np.abs(self.value(origin + distance[:, None] * direction)) < ON_SURFACE_MM * (1 + length))
        starts_inside = np.where(found, climb > 0, self.value(origin) <= 0)
        return Crossings(
            np.where(found, distance, np.inf)[:, None], np.zeros((len(origin), 1), np.int64), starts_inside
        )
