"""Which colour planes of a photo the display lights: one primary alone keeps a glass's dispersion out of a stripe."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, UInt8, UInt16

from recon.calibration.display_light import Region
from recon.sessions.photos import PLANE_OF_PRIMARY

Colours = UInt8[np.ndarray, "rows cols 3"] | UInt16[np.ndarray, "rows cols 3"]
Primary = Literal["white", "red", "green", "blue"]

# A plane with less than this share of the strongest one's light is what filters let through.
LARGEST_STRAY_SHARE = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class PrimaryPlanes:
    """Light in the planes blue, green and red as shares of the strongest; ``grey`` where a photo has no colour at all."""

    share: Float64[np.ndarray, " 3"]
    sd: Float64[np.ndarray, " 3"]
    grey: bool

    @property
    def strongest(self) -> str:
        """The name of the plane that gets most."""
        return next(name for name, plane in PLANE_OF_PRIMARY.items() if plane == int(np.argmax(self.share)))


def measure_planes(lit: Colours, dark: Colours, region: Region) -> PrimaryPlanes:
    """Return how the light of a display is spread over the planes of a photo (blue, green, red).

    Raises
    ------
    ValueError
        Where the region is empty or gets no light.
    """
    gain = lit[region].astype(np.float64) - dark[region]
    if not gain.size or gain.mean(axis=0).max() <= 0:
        raise ValueError("the display is not lit in the photo")
    mean, sd = gain.mean(axis=0), gain.std(axis=0) / np.sqrt(len(gain))
    strongest = mean.max()
    grey = bool(np.array_equal(lit[..., 0], lit[..., 1]) and np.array_equal(lit[..., 1], lit[..., 2]))
    return PrimaryPlanes(mean / strongest, sd / strongest, grey)


def primary_warnings(planes: PrimaryPlanes, primary: Primary) -> tuple[str, ...]:
    """Return what to do where the display lights other planes than those of its primary."""
    if primary == "white":
        return ()
    if planes.grey:
        return (
            f"The photos are grey, so that it cannot be seen whether the display shows {primary} alone: photograph in colour "
            "once, or look.",
        )
    if planes.strongest != primary:
        return (
            f"The display is configured to show {primary}, but photos are lit most in {planes.strongest}: correct primary in "
            "section [display], or the camera's white balance.",
        )
    stray = np.delete(planes.share, PLANE_OF_PRIMARY[primary]).max()
    if stray > LARGEST_STRAY_SHARE:
        return (
            f"Another plane gets {100 * stray:.0f} % of the light of {primary}: fix the camera's white balance to daylight and "
            "switch its picture style to neutral.",
        )
    return ()
