"""What places beside an edge of the map are off by: their neighbours' shifts, and how unsure these are there.

See :mod:`recon.sweeps.centre_places`, whose windows hold no edge.
"""

import numpy as np
from jaxtyping import Bool, Float32

from recon.compiled import compiled

# From a pixel with a window of its own its shift is told to others so far away.
SPREAD_PX = 6
# Two places nearer to each other than that (device pixels) make one curve, and nothing shows that it is of two.
SMALL_JUMP_PX = np.float32(1.5)
# An edge that goes through a pixel leaves up to half of it to the other side: of the jump, 1/√24 rms.
JUMP_SHARE = np.float32(0.2)

SmallGrid = Float32[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]


def told_to_others(shift: SmallGrid, known: Mask, place: SmallGrid, fading: SmallGrid, there: Mask) -> SmallGrid:
    """Fill in the mean of the shifts beside pixels without one, from pixel to pixel; return the sd of these, 0 elsewhere."""
    told, doubt = known.copy(), np.zeros(known.shape, np.float32)
    others = np.flatnonzero(there & ~told)
    for _ in range(SPREAD_PX):
        means, doubts = np.full((2, len(others)), np.nan, np.float32)
        _write_means_beside(shift, told, place, fading, there, others, means, doubts)
        now = np.isfinite(means)
        if not now.any():
            break
        shift.ravel()[others[now]], told.ravel()[others[now]] = means[now], True
        doubt.ravel()[others[now]] = np.hypot(means[now], doubts[now])
        others = others[~now]
    return doubt


@compiled
def _write_means_beside(
    shift: np.ndarray,
    told: np.ndarray,
    place: np.ndarray,
    fading: np.ndarray,
    there: np.ndarray,
    pixels: np.ndarray,
    means: np.ndarray,
    doubts: np.ndarray,
) -> None:
    """Write the mean shift of the neighbours of some pixels that were told theirs, where there are any.

    Beside it, by how much light that fades as it does towards a pixel may move its place, g·a/12, and a bend, C/24. The bend is
    that of the pixel, its neighbour and the one behind, and counts twice, since it grows outwards. Where it is most of what they
    differ by, an edge of the map lies between them: of a small jump the pixel may see a share itself.
    """
    rows, cols = told.shape
    for number in range(len(pixels)):
        row, col = pixels[number] // cols, pixels[number] % cols
        count, total, doubt = 0, np.float32(0), np.float32(0)
        for near_row in range(max(row - 1, 0), min(row + 2, rows)):
            for near_col in range(max(col - 1, 0), min(col + 2, cols)):
                if told[near_row, near_col]:
                    count += 1
                    total += shift[near_row, near_col]
                    behind_row, behind_col = 2 * near_row - row, 2 * near_col - col
                    if 0 <= behind_row < rows and 0 <= behind_col < cols and there[behind_row, behind_col]:
                        step = place[near_row, near_col] - place[row, col]
                        next_step = place[behind_row, behind_col] - place[near_row, near_col]
                        bend, faded = abs(next_step - step), abs(step * (fading[near_row, near_col] - fading[row, col]))
                        if 2 * bend <= abs(step) + abs(next_step):
                            apart = 12 * np.float32((near_row - row) ** 2 + (near_col - col) ** 2)
                            doubt = max(doubt, (bend + faded) / apart)
                        elif bend < SMALL_JUMP_PX:
                            doubt = max(doubt, JUMP_SHARE * bend)
        if count:
            means[number], doubts[number] = total / np.float32(count), doubt
