"""Edges of the object that air shows too: outline, creases, and lines where light begins to take another way through the glass.

A compressed photo carries an edge through whole blocks of pixels, so that near one neighbours' curves and gaps may be wrong alike
with nothing wrong in the liquid. What the liquid alone does (bubbles) leaves no trace in the dry sets, and so makes no edge.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label

from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult

# JPEG's blocks, counted from the photo's corner: an edge spoils those that it goes through.
BLOCK_PX = 8
# Fewer pixels together are specks and no edge.
SMALLEST_PX = 9
# Over two pixels, so that a mixed one may lie on the edge, a place steps so many times farther than beside it, and farther than
# noise and what one device pixel hides.
STRIDE_PX = 2
STEP_RATIO, STEP_PX = 3.0, 1.0

Mask = Bool[np.ndarray, "rows cols"]
Places = Float[np.ndarray, "rows cols"]


def dry_edge_blocks(
    sweeps: Mapping[tuple[str, str], SweepResult], past: Mask, *, corner: tuple[int, int] = (0, 0)
) -> Mask:
    """Return the pixels of the blocks that an edge goes through; ``past`` pixels look past the object.

    ``corner`` is the row and the column of the photo at which the maps begin.
    """
    elsewhere = past.copy()
    for (name, _), sweep in sweeps.items():
        if name.endswith("_air"):
            elsewhere |= (sweep.status != PixelStatus.OK) | jumps(sweep.place_px)
    regions, _ = label(elsewhere, np.ones((3, 3), dtype=bool))
    return in_blocks(elsewhere & (np.bincount(regions.ravel()) >= SMALLEST_PX)[regions], corner=corner)


def in_blocks(found: Mask, *, corner: tuple[int, int]) -> Mask:
    """Return all pixels of the blocks that hold one of ``found``.

    Examples
    --------
    >>> found = np.zeros((1, 20), dtype=bool)
    >>> found[0, 8] = True
    >>> [np.flatnonzero(in_blocks(found, corner=(0, col))[0]).tolist() for col in (0, 3)]
    [[8, 9, 10, 11, 12, 13, 14, 15], [5, 6, 7, 8, 9, 10, 11, 12]]
    """
    rows, cols = found.shape
    above, left = corner[0] % BLOCK_PX, corner[1] % BLOCK_PX
    padded = np.pad(found, ((above, -(above + rows) % BLOCK_PX), (left, -(left + cols) % BLOCK_PX)))
    blocks = padded.reshape(padded.shape[0] // BLOCK_PX, BLOCK_PX, -1, BLOCK_PX).any(axis=(1, 3))
    whole = blocks.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)
    return whole[above : above + rows, left : left + cols]


def jumps(place_px: Places) -> Mask:
    """Return the pixels across which the place jumps, along rows or along columns.

    Examples
    --------
    >>> smooth, jump = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0], [0.0, 0.5, 1.0, 9.0, 9.5, 10.0, 10.5]
    >>> jumps(np.array([smooth, jump]))[1].tolist()
    [False, False, True, True, True, False, False]
    """
    found = np.zeros(place_px.shape, dtype=bool)
    for axis in (0, 1):
        place, marked = np.moveaxis(place_px, axis, 0), np.moveaxis(found, axis, 0)
        step = np.abs(place[STRIDE_PX:] - place[:-STRIDE_PX])
        before, step, after = step[: -2 * STRIDE_PX], step[STRIDE_PX:-STRIDE_PX], step[2 * STRIDE_PX :]
        with np.errstate(invalid="ignore"):
            far = step > STEP_RATIO * np.maximum(before, after) + STEP_PX
        for offset in range(STRIDE_PX + 1):
            marked[STRIDE_PX + offset : STRIDE_PX + offset + len(far)] |= far
    return found
