"""Is the scale right? A length that somebody measured with a caliper, against the same length as the calibration has it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.calibration.errors import CalibrationError
from recon.sessions.manifest import DisplayPanel

AGREE_SIGMA = 3.0


@dataclass(frozen=True, slots=True)
class CaliperCheck:
    """The distance of two named points, twice: by caliper and by calibration, each with its standard deviation."""

    first: str
    second: str
    caliper_mm: float
    caliper_sd_mm: float
    found_mm: float
    found_sd_mm: float

    def ratio(self) -> float:
        """Return true over found length: what all lengths, and the display's pitch, should be multiplied by."""
        return self.caliper_mm / self.found_mm

    def ratio_sd(self) -> float:
        """Return the standard deviation of :meth:`ratio`."""
        return self.ratio() * float(np.hypot(self.caliper_sd_mm / self.caliper_mm, self.found_sd_mm / self.found_mm))

    def sigma(self) -> float:
        """Return the difference of the two lengths in its standard deviations."""
        return abs(self.caliper_mm - self.found_mm) / float(np.hypot(self.caliper_sd_mm, self.found_sd_mm))

    def agrees(self) -> bool:
        """Tell whether the lengths agree within three standard deviations."""
        return self.sigma() <= AGREE_SIGMA

    def sentence(self) -> str:
        """Say what was compared, and what to do where it differs."""
        compared = (
            f"{self.first} to {self.second}: {self.caliper_mm:.3f} mm ± {self.caliper_sd_mm:.3f} mm by caliper, "
            f"{self.found_mm:.3f} mm ± {self.found_sd_mm:.3f} mm found"
        )
        if self.agrees():
            return f"the scale is right ({compared})"
        return (
            f"the scale is off by a factor {self.ratio():.5f} ± {self.ratio_sd():.5f} ({compared}); "
            "measure again, and correct the display's pitch by this factor"
        )


def caliper_check(
    first: tuple[str, Float64[np.ndarray, " 3"]],
    second: tuple[str, Float64[np.ndarray, " 3"]],
    covariance: Float64[np.ndarray, "6 6"],
    *,
    caliper_mm: float,
    caliper_sd_mm: float,
) -> CaliperCheck:
    """Compare the distance of two points (name, place in mm) with what a caliper says.

    ``covariance`` is the joint one of both places, the first point's three numbers first.
    """
    if not caliper_mm > 0 or not caliper_sd_mm > 0:
        raise CalibrationError(
            f"caliper: {caliper_mm:g} mm ± {caliper_sd_mm:g} mm is no length with its uncertainty; a steel caliper has ± 0.02 mm"
        )
    apart = second[1] - first[1]
    found_mm = float(np.linalg.norm(apart))
    if found_mm == 0:
        raise CalibrationError(f"caliper: {first[0]} and {second[0]} are the same point; choose two that lie far apart")
    towards = np.concatenate([-apart, apart]) / found_mm
    found_sd_mm = float(np.sqrt(towards @ covariance @ towards))
    return CaliperCheck(first[0], second[0], caliper_mm, caliper_sd_mm, found_mm, found_sd_mm)


def panel_check(
    display: DisplayPanel, pixels: float, *, pitch_sd_share: float, caliper_mm: float, caliper_sd_mm: float
) -> CaliperCheck:
    """Compare a stretch of so many device pixels, which follows from the display's pitch, with a caliper's.

    ``pitch_sd_share`` is how well the pitch is known, as a share of itself; 0 where it was taken as given.
    """
    most = max(display.columns, display.rows)
    if not 0 < pixels <= most:
        raise CalibrationError(f"caliper: {pixels:g} pixels asked, the display has 1 to {most} along its longer side")
    points = [(f"pixel {place:g}", np.array([place * display.pitch_mm, 0.0, 0.0])) for place in (0.0, pixels)]
    # A pitch that is off stretches both places alike: their errors are one number times the places.
    stretch = np.concatenate([point for _, point in points]) * pitch_sd_share
    return caliper_check(
        points[0], points[1], np.outer(stretch, stretch), caliper_mm=caliper_mm, caliper_sd_mm=caliper_sd_mm
    )
