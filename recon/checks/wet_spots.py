"""Spots that are sound in air and not in the liquid: bubbles, most likely."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, UInt8
from scipy.ndimage import binary_closing, binary_fill_holes, binary_opening, binary_propagation, find_objects, label

from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult

# A crease or a rim that looks odd in liquid alone is a line of a pixel or two; a bubble is a patch.
PATCH = np.ones((3, 3), dtype=bool)
# What is larger than this share of the object is not a spot.
LARGEST_SHARE = 0.05
# A bubble is round, and seen through a lens oval; longer patches lie along edges of the object or rows of display pixels.
LONGEST = 3.0

Mask = Bool[np.ndarray, "rows cols"]


@dataclass(frozen=True, slots=True)
class WetSpot:
    """A spot: its middle in the photo and its pixels."""

    row: int
    col: int
    pixels: int


def wet_spots(
    sweeps: Mapping[tuple[str, str], SweepResult], status: UInt8[np.ndarray, "rows cols"], shared: Mask
) -> tuple[WetSpot, ...]:
    """Return the spots, the largest first.

    A pixel belongs to one if it has places in both dry sets, and in the wet ones either no curve of one stripe, or paths that
    miss the dry ones as their neighbours' do (``shared``).
    """
    dry = [one.status == PixelStatus.OK for (name, _), one in sweeps.items() if name.endswith("_air")]
    wet = [one.status == PixelStatus.BAD_FIT for (name, _), one in sweeps.items() if name.endswith("_liquid")]
    if not dry or not wet:
        return ()
    sound = np.logical_and.reduce(dry)
    bad = sound & (np.logical_or.reduce(wet) | (status == PixelStatus.GAP_TOO_LARGE) | shared)
    whole = binary_fill_holes(binary_closing(bad, PATCH)) & sound
    patches = binary_propagation(binary_opening(whole, PATCH), mask=whole)
    regions, count = label(patches, PATCH)
    size = np.bincount(regions.ravel(), minlength=count + 1)
    largest = LARGEST_SHARE * np.count_nonzero(
        np.isin(status, (PixelStatus.OK, PixelStatus.GAP_TOO_LARGE, PixelStatus.BAD_FIT))
    )
    spots = [
        WetSpot((rows.start + rows.stop - 1) // 2, (cols.start + cols.stop - 1) // 2, int(size[number]))
        for number, (rows, cols) in enumerate(find_objects(regions), start=1)
        if size[number] <= largest and _elongation(regions[rows, cols] == number) <= LONGEST
    ]
    return tuple(sorted(spots, key=lambda spot: -spot.pixels))


def _elongation(patch: Mask) -> float:
    """Return the length over the width of a patch, by its second moments.

    Examples
    --------
    >>> round(_elongation(np.ones((3, 12), dtype=bool)), 6)
    4.0
    """
    place = np.argwhere(patch).astype(np.float64)
    # A pixel is a square, whose own second moment is a twelfth.
    moments = np.cov(place.T, bias=True) + np.eye(2) / 12
    least, most = np.linalg.eigvalsh(moments)
    return float(np.sqrt(most / least))
