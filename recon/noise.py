"""The noise of the photos, measured from the photos: dark noise between two photos, shot noise from the fit's residuals."""

import itertools
from dataclasses import dataclass

import numpy as np

# Rounding to whole counts alone has this variance.
ROUNDING_VARIANCE = 1 / 12
# Median of the square of a standard normal variable.
CHI_SQUARE_MEDIAN = 0.4549
SIGNAL_BINS = 12
FEWEST_IN_BIN = 200


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Variance of one count: ``read_variance + gain * (count above black)``, in counts squared."""

    read_variance: float
    gain: float

    def variance(self, signal: np.ndarray) -> np.ndarray:
        """Return the variance of samples whose expected height above black is ``signal``."""
        return self.read_variance + self.gain * np.maximum(signal, 0.0)


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
    model weigh little, and a line is laid through them.
    """
    edges = np.quantile(signal, np.linspace(0.0, 1.0, SIGNAL_BINS + 1))
    places, variances = [], []
    for low, high in itertools.pairwise(edges):
        inside = (signal >= low) & (signal <= high)
        if np.count_nonzero(inside) >= FEWEST_IN_BIN:
            places.append(float(signal[inside].mean()))
            variances.append(float(np.median(residual[inside] ** 2)) / CHI_SQUARE_MEDIAN / freedom_share)
    if len(places) < 2:
        return NoiseModel(read_variance, 0.0)
    excess = np.array(variances) - read_variance
    # Relative errors of the binned variances are alike, so each weighs by one over its square.
    weight = 1 / np.maximum(np.array(variances), ROUNDING_VARIANCE) ** 2
    gain = float((weight * np.array(places) * excess).sum() / (weight * np.array(places) ** 2).sum())
    return NoiseModel(read_variance, max(gain, 0.0))
