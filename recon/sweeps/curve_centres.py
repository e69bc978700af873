"""The centre of mass of each pixel's curve: a first guess of its place, made before anything is known of noise and footprints."""

import numpy as np
from jaxtyping import Float32, Int

from recon.compiled import compiled
from recon.sweeps.curve_samples import SweepCurves

# The part of a curve above this share of its peak tells its centre.
CENTRE_LEVEL = 0.1
LEAST_LIGHT = 1e-9


def curve_centres(
    curves: SweepCurves, pixels: Int[np.ndarray, " pixels"], *, grid: tuple[int, int]
) -> Float32[np.ndarray, "rows cols"]:
    """Return the centres of mass of the listed pixels' curves about their peaks, in device pixels; else NaN."""
    windows, pattern = curves.windows, curves.table.pattern
    number = np.full(grid[0] * grid[1], np.nan, dtype=np.float32)
    write_centres(pixels, windows.samples, windows.peak_index, curves.black, windows.photo_count, number)
    number *= np.float32(pattern.step_px)
    number += np.float32(pattern.first_px)
    return number.reshape(grid)


@compiled
def write_centres(
    pixels: np.ndarray, samples: np.ndarray, peak: np.ndarray, black: np.ndarray, photo_count: int, number: np.ndarray
) -> None:
    """Write the centres of mass of some pixels, in stripe numbers, over all samples [pixels, window] inside the sweep."""
    count = samples.shape[1]
    half = count // 2
    for each in range(len(pixels)):
        pixel = np.uintp(pixels[each])
        dark, stripe = float(black[pixel]), peak[pixel]
        least = CENTRE_LEVEL * (samples[pixel, half] - dark)
        light, moment = 0.0, 0.0
        for s in range(np.uintp(count)):
            offset = np.intp(s) - half
            height = samples[pixel, s] - dark
            if height > least and 0 <= stripe + offset < photo_count:
                light += height
                moment += height * offset
        number[pixel] = stripe + moment / max(light, LEAST_LIGHT)
