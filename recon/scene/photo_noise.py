"""The noise of a photo's counts, which grows with the light, from two photos of a scene at rest."""

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from recon.sweeps.noise import CHI_SQUARE_MEDIAN, ROUNDING_VARIANCE

Photo = Float32[np.ndarray, "rows columns"]
Mask = Bool[np.ndarray, "rows columns"]

LEVEL_BINS = 10
FEWEST_IN_BIN = 50


@dataclass(frozen=True, slots=True)
class PhotoNoise:
    """Variance of one photo's counts, ``floor + slope · level``, and what the blocks really scatter over what it predicts.

    ``inflation`` is 1 for white noise; a camera that smooths or compresses its photos makes it larger.
    """

    floor: float
    slope: float
    inflation: float = 1.0

    def variance(self, level: Photo) -> Photo:
        """Return the variance of the difference of two photos at each place."""
        one = np.float32(self.floor) + np.float32(self.slope) * np.maximum(level, 0)
        return 2 * np.maximum(one, np.float32(ROUNDING_VARIANCE))


def white_noise(first: Photo, second: Photo, mask: Mask) -> PhotoNoise:
    """Return how the noise of single pixels grows with the light, from two photos between which nothing changed.

    Raises ``ValueError`` when the mask holds too little to measure it from.
    """
    level, half_square = 0.5 * (first + second)[mask], 0.5 * ((second - first)[mask].astype(np.float64)) ** 2
    edges = np.quantile(level, np.linspace(0, 1, LEVEL_BINS + 1)) if level.size else np.zeros(2)
    places, variances = [], []
    for low, high in itertools.pairwise(edges):
        inside = (level >= low) & (level <= high)
        if np.count_nonzero(inside) >= FEWEST_IN_BIN:
            places.append(float(level[inside].mean()))
            # Counts are whole numbers, whose median jumps; the mean of what lies within three times it does not.
            square = half_square[inside]
            limit = 9 * max(float(np.median(square)) / CHI_SQUARE_MEDIAN, ROUNDING_VARIANCE)
            variances.append(float(square[square <= limit].mean()))
    if not places:
        raise ValueError("too few pixels to measure the photos' noise")
    slope, floor = np.polyfit(places, variances, 1) if len(places) > 2 else (0.0, float(np.mean(variances)))
    if slope < 0:
        slope, floor = 0.0, float(np.mean(variances))
    elif floor < 0:
        slope, floor = float(np.dot(places, variances) / np.dot(places, places)), 0.0
    return PhotoNoise(float(floor), float(slope))
