"""Why a camera pixel has a point, or has none: the ``status`` map of ``maps.npz``."""

from collections.abc import Iterable
from enum import IntEnum

import numpy as np
import numpy.typing as npt


class PixelStatus(IntEnum):
    """One reason a pixel; the first test that fails names it."""

    OK = 0
    UNLIT = 1
    PARTLY_LIT = 2
    MASKED_OUT = 3
    SWEEP_EDGE = 4
    BAD_FIT = 5
    PARALLEL_PATHS = 6
    GAP_TOO_LARGE = 7
    OUTSIDE_DEPTH = 8
    BESIDE_OBJECT = 9
    BAD_CODE = 10
    TWO_PATHS = 11
    HALF_SEEN = 12
    STANDS_ALONE = 13
    COVERED = 14
    WET_SPOT = 15


REASONS: dict[PixelStatus, str] = {
    PixelStatus.OK: "has a point and a normal",
    PixelStatus.UNLIT: "saw the stripe in no set",
    PixelStatus.PARTLY_LIT: "saw the stripe in some sets only",
    PixelStatus.MASKED_OUT: "outside the session's mask",
    PixelStatus.SWEEP_EDGE: "brightest at the first or last stripe place: the peak may lie outside the sweep",
    PixelStatus.BAD_FIT: "its intensity curve is not that of one stripe (a moving scene, clipping)",
    PixelStatus.PARALLEL_PATHS: "the two light paths are nearly parallel and fix no point",
    PixelStatus.GAP_TOO_LARGE: "the two light paths miss each other",
    PixelStatus.OUTSIDE_DEPTH: "the point is not between display and camera",
    PixelStatus.BESIDE_OBJECT: "looks past the object at the liquid's own flat surface",
    PixelStatus.BAD_CODE: "its coarse photos leave in doubt which period of the fine ones it sees",
    PixelStatus.TWO_PATHS: "sees the display by two light paths, and does not say which belong together",
    PixelStatus.HALF_SEEN: "an edge leaves less than half of its light: its centre sees nothing of the display",
    PixelStatus.STANDS_ALONE: "its point lies on no surface with those about it: stray light, or parts of two paths",
    PixelStatus.COVERED: "its own measurement was left out; point and normal are those of the surface about it",
    PixelStatus.WET_SPOT: "lies in a spot that is sound in air and not in the liquid: a bubble, most likely",
}

StatusMap = npt.NDArray[np.uint8]


def is_one_of(status: npt.NDArray[np.uint8], those: Iterable[PixelStatus]) -> npt.NDArray[np.bool_]:
    """Return which statuses are one of those. For a whole photo, comparisons take a tenth of the time of a table's look-ups.

    Examples
    --------
    >>> is_one_of(np.array([0, 1, 11], np.uint8), (PixelStatus.OK, PixelStatus.TWO_PATHS)).tolist()
    [True, False, True]
    """
    found = np.zeros(status.shape, dtype=bool)
    for one in those:
        found |= status == np.uint8(one)
    return found
