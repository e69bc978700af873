"""Standard deviations widened where curves are not quite the model's (Birge's ratio).

The ratio of the neighbourhood counts, whose own scatter is small; a pixel's own one does where chance does not explain it.
"""

import numpy as np
from jaxtyping import Float32, Int
from scipy.special import chdtri

from recon.compiled import compiled
from recon.sweeps.fitted_pixels import laid

# One good curve in a thousand is taken for a bad one, whose own misfit then widens its sd.
OWN_MISFIT_CHANCE = 1e-3
SCALE_WINDOW_PX = 11
BAND_ROWS = 128
LARGEST_CLEAN_RATIO = 4.0


def widen_by_misfit(
    sd_px: Float32[np.ndarray, "rows cols"],
    misfit: Float32[np.ndarray, " pixels"],
    freedom: Float32[np.ndarray, " pixels"],
    pixels: Int[np.ndarray, " pixels"],
) -> None:
    """Widen each sd in place; ``misfit`` is chi-square over ``freedom`` of the listed pixels, in ascending order."""
    # The limit over the degrees of freedom is least where these are most: few pixels are worth asking for their own.
    most = float(np.fmax.reduce(freedom, initial=np.float32(1)))
    least_limit = np.float32(chdtri(most, OWN_MISFIT_CHANCE) / most)
    margin = SCALE_WINDOW_PX // 2
    rows, columns = sd_px.shape
    # Of a band of rows: by how much variances grow, and the pixels that are worth asking. What the next band sees of this one
    # is whether a pixel has an sd, which does not change.
    scale, doubtful = np.empty((BAND_ROWS, columns), np.float32), np.empty(BAND_ROWS * columns, np.int32)
    for low in range(0, rows, BAND_ROWS):
        high = min(low + BAND_ROWS, rows)
        if not np.isfinite(sd_px[low:high]).any():
            continue
        band = slice(max(low - margin, 0), min(high + margin, rows))
        ratio = laid(misfit, pixels, band, columns=columns)
        own, local = slice(low - band.start, high - band.start), scale[: high - low]
        these = doubtful[: write_scales(ratio, sd_px[band], own.start, least_limit, local, doubtful)]
        told = ratio[own].ravel()[these]
        freedoms = freedom[np.searchsorted(pixels, (these + low * columns).astype(pixels.dtype))].astype(np.float64)
        beside = local.ravel()[these]
        limit = beside * chdtri(freedoms, OWN_MISFIT_CHANCE) / freedoms
        local.ravel()[these] = np.maximum(beside, np.where(told > limit, told, 0))
        sd_px[low:high] *= np.sqrt(local, out=local)


@compiled
def write_scales(
    ratio: np.ndarray, sd: np.ndarray, above: int, least_limit: np.float32, scale: np.ndarray, doubtful: np.ndarray
) -> int:
    """Write the mean ratio about each pixel, 1 at least, in the rows of a band that follow the ``above`` first ones.

    Pixels without an sd do not count. The numbers of those whose own ratio is far larger are written too; return how many.
    """
    rows, cols = ratio.shape
    half, one, zero = SCALE_WINDOW_PX // 2, np.float32(1), np.float32(0)
    largest = np.float32(LARGEST_CLEAN_RATIO)
    # Of each column, with a margin on both sides: the sum over the rows of the window, and how many pixels count. What is
    # added and taken away again are few digits, so that nothing is left behind.
    total, number = np.zeros(cols + 2 * half + 1), np.zeros(cols + 2 * half + 1)
    found = 0
    for bottom in range(rows + half):
        for sign, row in ((1.0, bottom), (-1.0, bottom - 2 * half - 1)):
            if 0 <= row < rows:
                for col in range(cols):
                    good = np.isfinite(sd[row, col])
                    total[half + 1 + col] += sign * (min(ratio[row, col], largest) if good else zero)
                    number[half + 1 + col] += sign if good else 0.0
        row = bottom - half
        if row < above or row >= above + len(scale):
            continue
        summed, count = 0.0, 0.0
        for col in range(2 * half):
            summed += total[1 + col]
            count += number[1 + col]
        for col in range(cols):
            summed += total[col + 2 * half + 1] - total[col]
            count += number[col + 2 * half + 1] - number[col]
            local = max(np.float32(summed) / max(np.float32(count), one), one)
            scale[row - above, col] = local
            if np.isfinite(sd[row, col]) and ratio[row, col] > local * least_limit:
                doubtful[found] = (row - above) * cols + col
                found += 1
    return found
