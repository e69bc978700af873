"""The noise of the photos, measured from the photos: dark noise between two photos, shot noise from the fit's residuals."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

# Rounding to whole counts alone has this variance.
ROUNDING_VARIANCE = 1 / 12
# Median of the square of a standard normal variable.
CHI_SQUARE_MEDIAN = 0.4549
SIGNAL_BINS = 12
FEWEST_IN_BIN = 200


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """The photon transfer curve of the photos: variance of one count whose expected height above black is s.

    ``read_variance + gain * s + (relative * s)²``, in counts squared: read noise and rounding, shot noise, and what grows
    with the signal itself (pixels and display places that are not alike, a model that is not quite the curve).
    """

    read_variance: float
    gain: float = 0.0
    relative: float = 0.0

    def variance(self, signal: np.ndarray) -> np.ndarray:
        """Return the variance of samples whose expected height above black is ``signal``."""
        height = np.maximum(signal, 0.0)
        return self.read_variance + self.gain * height + (self.relative * height) ** 2


def dark_variance(first: np.ndarray, second: np.ndarray) -> float:
    """Return the variance of a dark sample from two photos of the same scene [rows, cols] with the stripe elsewhere.

    Pixels that the stripe lights in one of them stand out and are left out, three rounds at five sigma.
    """
    difference = second.astype(np.float64) - first.astype(np.float64)
    limit = 5 * max(1.4826 * float(np.median(np.abs(difference))), 1.0) * np.sqrt(2)
    for _ in range(3):
        kept = difference[np.abs(difference) <= limit]
        variance = float(kept.var()) / 2
        limit = 5 * np.sqrt(2 * max(variance, ROUNDING_VARIANCE))
    return max(variance, ROUNDING_VARIANCE)


def noise_from_residuals(
    signal: np.ndarray, residual: np.ndarray, *, read_variance: float, freedom_share: float
) -> NoiseModel:
    """Return the noise model that the residuals of a first fit show.

    ``signal`` is the model's height above black and ``residual`` the sample minus the model, in counts; ``freedom_share`` is
    degrees of freedom over samples. Variances are taken bin by bin from medians, so that pixels that do not follow the
    model weigh little, and the two terms that grow with the signal are laid through them, neither below zero.
    """
    brightest = float(np.quantile(signal, 0.999))
    edges = np.geomspace(max(np.sqrt(read_variance), brightest * 1e-3), brightest, SIGNAL_BINS + 1)
    places, variances = [], []
    for low, high in itertools.pairwise(edges):
        inside = (signal >= low) & (signal <= high)
        if np.count_nonzero(inside) >= FEWEST_IN_BIN:
            places.append(float(signal[inside].mean()))
            variances.append(float(np.median(residual[inside] ** 2)) / CHI_SQUARE_MEDIAN / freedom_share)
    if len(places) < 3:
        return NoiseModel(read_variance)
    place, variance = np.array(places), np.array(variances)
    # Relative errors of the binned variances are alike, so each weighs by one over itself.
    weight = 1 / np.maximum(variance, ROUNDING_VARIANCE)
    terms = np.stack([place, place**2], axis=1) * weight[:, None]
    (gain, relative_squared), _ = nnls(terms, np.maximum(variance - read_variance, 0.0) * weight)
    return NoiseModel(read_variance, float(gain), float(np.sqrt(relative_squared)))
