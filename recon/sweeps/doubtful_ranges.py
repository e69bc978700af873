"""Which rows and columns of the display are worth an ordinary sweep after a code left pixels in doubt there."""

import cv2
import numpy as np
from jaxtyping import Float, Float64, UInt8

from recon.metrics import DoubtfulRange
from recon.sessions.pattern import GrayLinePattern, Pattern, StripePattern
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult

DOUBTFUL = (PixelStatus.BAD_CODE, PixelStatus.BAD_FIT)
# A doubtful pixel looks where its nearest neighbour with a place looks; this many photo pixels off, that says nothing.
REACH_PX = 5.0
# A range that so few pixels need is not worth its photos.
FEWEST_PIXELS = 10


def doubtful_ranges(
    result: SweepResult, pattern: Pattern, *, set_name: str, axis: str, device_px: int
) -> tuple[DoubtfulRange, ...]:
    """Return the ranges of device pixels where a sweep would help, each with the number of pixels that need it.

    A range reaches one period beyond the places of the pixels' neighbours. A sweep itself leaves none: it saw all there is.
    """
    if isinstance(pattern, StripePattern):
        return ()
    margin_px = pattern.period_px if isinstance(pattern, GrayLinePattern) else pattern.periods_px[-1]
    places = np.sort(_places_nearby(result.place_px, result.status))
    if len(places) == 0:
        return ()
    parts = np.split(places, np.flatnonzero(np.diff(places) > 2 * margin_px) + 1)
    return tuple(
        DoubtfulRange(
            set=set_name,
            axis="x" if axis == "x" else "y",
            first_px=int(max(np.floor(part[0] - margin_px), 0)),
            last_px=int(min(np.ceil(part[-1] + margin_px), device_px - 1)),
            pixels=len(part),
        )
        for part in parts
        if len(part) >= FEWEST_PIXELS
    )


def _places_nearby(
    place_px: Float[np.ndarray, "rows cols"], status: UInt8[np.ndarray, "rows cols"]
) -> Float64[np.ndarray, " doubtful"]:
    """Return the place of the nearest pixel that has one, for each doubtful pixel that has such a neighbour."""
    fine = status == PixelStatus.OK
    doubtful = np.isin(status, DOUBTFUL)
    if not fine.any() or not doubtful.any():
        return np.empty(0)
    distance_px, label = cv2.distanceTransformWithLabels(
        (~fine).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    place_of_label = np.zeros(int(label.max()) + 1)
    place_of_label[label[fine]] = place_px[fine]
    return place_of_label[label[doubtful & (distance_px <= REACH_PX)]]
