"""The reference frame: a whole image whose shifts can be measured anywhere, beside the object and through it.

A random texture without repeats. Its finest detail is a few photo pixels where the display is seen directly, its coarsest
eight times that, so that something of it is left to measure where the object makes it smaller or larger.
"""

import numpy as np
from jaxtyping import UInt8

OCTAVES = 3
# Every rig shows the same texture; a photo is only ever compared with another photo of it.
SEED = 1
MEAN_LEVEL = 128.0
# Two and a half of these reach full black and white; the rest is cut off.
LEVEL_SD = 50.0
SMALLEST_PERIOD_PX = 3.0


def reference_levels(*, columns: int, rows: int, finest_px: float) -> UInt8[np.ndarray, "rows columns"]:
    """Return the drive levels of the reference frame.

    ``finest_px`` is the shortest period in device pixels. The power is spread evenly over the octaves from there to eight
    times as much, the same in all directions.
    """
    finest_px = max(finest_px, SMALLEST_PERIOD_PX)
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)[None, :])
    inside = (frequency <= 1 / finest_px) & (frequency >= 1 / (finest_px * 2**OCTAVES))
    # Even power over octaves in two dimensions: amplitude as one over frequency.
    amplitude = np.divide(1.0, frequency, out=np.zeros_like(frequency), where=inside)
    noise = np.random.default_rng(SEED).standard_normal((rows, columns))
    texture = np.fft.irfft2(np.fft.rfft2(noise) * amplitude, s=(rows, columns))
    spread = float(texture.std())
    if spread > 0:
        texture *= LEVEL_SD / spread
    return np.clip(np.rint(MEAN_LEVEL + texture), 0, 255).astype(np.uint8)
