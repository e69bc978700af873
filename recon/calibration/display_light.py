"""What a photo says of the display's light: the part of it that sees the display, and the mean of that part."""

import numpy as np
from jaxtyping import Bool, Float64, UInt8, UInt16

from recon.sessions.photos import saturation_count

Photo = UInt8[np.ndarray, "rows cols"] | UInt16[np.ndarray, "rows cols"]
Region = Bool[np.ndarray, "rows cols"]

# A pixel that sees the display loses less than half of the light that the brightest ones get; glass and edges lose more.
LEAST_SHARE_OF_LIGHT = 0.5
# What counts as brightest: few enough pixels that dust and reflections are no part of it.
BRIGHTEST_PERCENTILE = 95


def lit_region(white: Photo, black: Photo) -> Region:
    """Return the pixels that see the lit display: those that gain at least half of what the brightest ones gain.

    Empty where the display is not in the photo, or was not lit.
    """
    gain = white.astype(np.float64) - black
    brightest = float(np.percentile(gain, BRIGHTEST_PERCENTILE))
    noise = float(np.median(np.abs(gain - np.median(gain))))
    if brightest <= max(3 * noise, 1.0) and brightest < LEAST_SHARE_OF_LIGHT * float(gain.max()):
        brightest = float(gain.max())
    if brightest <= 1.0:
        return np.zeros(white.shape, dtype=bool)
    return gain >= LEAST_SHARE_OF_LIGHT * brightest


def mean_value(photo: Photo, region: Region) -> float:
    """Return the mean count in the region; NaN for an empty one."""
    return float(photo[region].mean()) if region.any() else float("nan")


def clipped_share(photo: Photo, region: Region) -> float:
    """Return the share of the region's pixels that are at the top of the range; 0 for an empty one."""
    return float((photo[region] >= saturation_count(photo)).mean()) if region.any() else 0.0


def row_values(photo: Photo, region: Region) -> Float64[np.ndarray, " rows"]:
    """Return the mean count of each row's part of the region; NaN where a row has less than half of the widest row's."""
    count = region.sum(axis=1)
    total = np.where(region, photo, 0).sum(axis=1, dtype=np.float64)
    enough = count > count.max() / 2
    return np.where(enough, total / np.maximum(count, 1), np.nan)


def upper_and_lower(region: Region) -> tuple[Region, Region]:
    """Return the halves of a region above and below its middle row."""
    rows = np.arange(region.shape[0])[:, None]
    middle = float(np.median(np.nonzero(region)[0])) if region.any() else 0.0
    return region & (rows <= middle), region & (rows > middle)


def places_of(halves: tuple[Region, Region]) -> tuple[float, float]:
    """Return where the mean rows of two regions are in the photo: 0 is its top, 1 its bottom."""
    upper, lower = (float((np.nonzero(half)[0].mean() + 0.5) / half.shape[0]) for half in halves)
    return upper, lower
