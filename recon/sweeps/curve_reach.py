"""How many photos a pixel's curve reaches to each side of its peak, from a few photos read beforehand.

A sharp image of the display shows the stripe's own profile; a defocused one, or a camera coarser than the display, shows curves
many times as wide, whose flanks hold most of what tells their centre. The windows must hold them, and no more.
"""

from collections.abc import Callable

import numpy as np

from recon.sessions.photos import Counts

# Below this share of the peak, at the end of the window, flanks tell nothing more of the centre.
LEVEL = 0.05
# One curve in twenty may be wider: the fit tells where the window cuts off too much of one.
CURVES_SHARE = 0.95
LADDER = (0, 4, 8, 12)
FEWEST_CURVES = 100
PROBES = (0.5, 0.25, 0.75)


def curve_half_width(
    photo: Callable[[int], Counts], numbers: range, *, black: Counts, floor: Counts, least: int
) -> int:
    """Return the half width of the windows, ``least`` or up to 12 more, in photos.

    ``photo(number)`` returns the counts [rows, cols] of one photo of the sweep; ``floor`` is what a lit sample exceeds.
    """
    for share in PROBES:
        middle = numbers[round(share * (len(numbers) - 1))]
        if middle - 1 not in numbers or middle + 1 not in numbers:
            continue
        centre = photo(middle)
        peak = (centre > floor) & (centre >= photo(middle - 1)) & (centre >= photo(middle + 1))
        height = centre[peak].astype(np.float64) - black[peak]
        if len(height) < FEWEST_CURVES:
            continue
        for more in LADDER:
            flanks = [photo(n)[peak] for n in (middle - least - more, middle + least + more) if n in numbers]
            if not flanks:
                return least + more
            flank = np.mean(flanks, axis=0)
            # What noise alone explains is no flank.
            wider = (flank - black[peak] > LEVEL * height) & (flank > floor[peak])
            if wider.mean() < 1 - CURVES_SHARE:
                return least + more
        return least + LADDER[-1]
    return least
