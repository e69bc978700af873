"""Spots that are sound in air and not in the liquid: bubbles, most likely."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int32, UInt8
from scipy.ndimage import (
    binary_closing,
    binary_dilation,
    binary_fill_holes,
    find_objects,
    label,
    uniform_filter,
)

from recon.checks.dry_edges import dry_edge_blocks
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult

# A crease or a rim that looks odd in liquid alone is a line of a pixel or two; a bubble is a patch.
PATCH = np.ones((3, 3), dtype=bool)
# Not every pixel of a bubble looks odd, but a good part of those about each that does, and more than chance puts together where
# odd pixels are everywhere.
DENSE_PX, DENSE_SHARE, DENSE_SIGMA = 5, 0.15, 4.0
# So far beyond the last odd pixel light still passes the bubble.
GROWN_PX = 2
SMALLEST_PX = 9
# A bubble shows a pixel the display by no path that is one curve, or by two.
BAD_IN_LIQUID = (PixelStatus.BAD_FIT, PixelStatus.TWO_PATHS)
# Of a bubble's odd pixels some lie where no edge spoils the photos' blocks.
CLEAR_SHARE = 0.25
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
    sweeps: Mapping[tuple[str, str], SweepResult],
    status: UInt8[np.ndarray, "rows cols"],
    shared: Mask,
    *,
    corner: tuple[int, int] = (0, 0),
) -> tuple[WetSpot, ...]:
    """Return the spots, the largest first; ``corner`` is the row and the column of the photo at which the maps begin.

    A pixel belongs to one if it has places in both dry sets, and in the wet ones either no curve of one stripe, or paths that
    miss the dry ones as their neighbours' do (``shared``).
    """
    regions, chosen = _regions(sweeps, status, shared, corner)
    size = np.bincount(regions.ravel())
    spots = [
        WetSpot((rows.start + rows.stop - 1) // 2, (cols.start + cols.stop - 1) // 2, int(size[number]))
        for number, (rows, cols) in chosen.items()
    ]
    return tuple(sorted(spots, key=lambda spot: -spot.pixels))


def spot_pixels(
    sweeps: Mapping[tuple[str, str], SweepResult],
    status: UInt8[np.ndarray, "rows cols"],
    *,
    corner: tuple[int, int] = (0, 0),
) -> Mask:
    """Return the pixels of all spots and those just beyond: what they measured in the liquid may be wrong unseen."""
    regions, chosen = _regions(sweeps, status, np.zeros(status.shape, dtype=bool), corner)
    spots = np.isin(regions, list(chosen))
    return binary_dilation(spots, PATCH, iterations=GROWN_PX) if chosen else spots


def _regions(
    sweeps: Mapping[tuple[str, str], SweepResult],
    status: UInt8[np.ndarray, "rows cols"],
    shared: Mask,
    corner: tuple[int, int],
) -> tuple[Int32[np.ndarray, "rows cols"], dict[int, tuple[slice, slice]]]:
    """Number the patches that are bad in liquid alone, and return the bounds of those that may be bubbles."""
    dry = [one.status == PixelStatus.OK for (name, _), one in sweeps.items() if name.endswith("_air")]
    wet = [np.isin(one.status, BAD_IN_LIQUID) for (name, _), one in sweeps.items() if name.endswith("_liquid")]
    if not dry or not wet:
        return np.zeros(status.shape, dtype=np.int32), {}
    sound = np.logical_and.reduce(dry)
    bad = sound & (np.logical_or.reduce(wet) | (status == PixelStatus.GAP_TOO_LARGE) | shared)
    by_edge = dry_edge_blocks(sweeps, status == PixelStatus.BESIDE_OBJECT, corner=corner)
    local = uniform_filter(bad.astype(np.float64), DENSE_PX, mode="constant")
    on_object = sound & (status != PixelStatus.BESIDE_OBJECT)
    typical = float(np.median(local[on_object])) if on_object.any() else 0.0
    chance = typical + DENSE_SIGMA * np.sqrt(typical * (1 - typical)) / DENSE_PX
    dense = bad & (local > max(DENSE_SHARE, chance))
    whole = binary_fill_holes(binary_closing(dense, np.ones((DENSE_PX, DENSE_PX), dtype=bool))) & sound
    regions, count = label(whole, PATCH)
    size = np.bincount(regions.ravel(), minlength=count + 1)
    largest = LARGEST_SHARE * np.count_nonzero(
        np.isin(status, (PixelStatus.OK, PixelStatus.WET_SPOT, PixelStatus.GAP_TOO_LARGE, PixelStatus.BAD_FIT))
    )
    clear = np.bincount(regions[dense & ~by_edge], minlength=count + 1)
    odd = np.bincount(regions[dense], minlength=count + 1)
    return regions, {
        number: (rows, cols)
        for number, (rows, cols) in enumerate(find_objects(regions), start=1)
        if SMALLEST_PX <= size[number] <= largest
        and clear[number] >= CLEAR_SHARE * odd[number]
        and _elongation(regions[rows, cols] == number) <= LONGEST
    }


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
