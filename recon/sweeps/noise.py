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
# Samples below this share of the brightest are dark ones.
DARK_SHARE = 2e-3
# The ringing of compressed photos comes seldom and is then many times the usual noise. A fit takes such a sample for light, so it
# counts; what is farther out, in variances, is light.
LARGEST_SQUARE = 64.0
COUNTED_AT_ONCE = 1 << 18


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
    difference, count = _differences(first.ravel(), second.ravel())
    limit = 5 * max(1.4826 * _median_magnitude(difference, count), 1.0) * np.sqrt(2)
    for _ in range(3):
        kept = np.abs(difference) <= limit
        mean = np.average(difference[kept], weights=count[kept])
        variance = float(np.average((difference[kept] - mean) ** 2, weights=count[kept])) / 2
        limit = 5 * np.sqrt(2 * max(variance, ROUNDING_VARIANCE))
    return max(variance, ROUNDING_VARIANCE)


def _differences(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return every difference of two arrays of whole counts [pixels], and how many pixels have it."""
    lowest = int(second.min()) - int(first.max())
    count = np.zeros(int(second.max()) - int(first.min()) - lowest + 1, dtype=np.int64)
    for low in range(0, first.size, COUNTED_AT_ONCE):
        part = slice(low, low + COUNTED_AT_ONCE)
        difference = second[part].astype(np.int64) - first[part] - lowest
        count += np.bincount(difference, minlength=len(count))
    seen = np.flatnonzero(count)
    return seen + lowest, count[seen]


def _median_magnitude(difference: np.ndarray, count: np.ndarray) -> float:
    """Return the median magnitude of differences, each of which so many pixels have."""
    order = np.argsort(np.abs(difference))
    up_to = np.cumsum(count[order])
    middle = np.searchsorted(up_to, [(up_to[-1] - 1) // 2, up_to[-1] // 2], side="right")
    return float(np.abs(difference)[order][middle].mean())


def _clipped_variance(residual: np.ndarray) -> float:
    """Return the mean square of the residuals without those beyond eight standard deviations."""
    square = residual.astype(np.float64) ** 2
    variance = float(np.median(square)) / CHI_SQUARE_MEDIAN
    for _ in range(3):
        variance = float(square[square <= LARGEST_SQUARE * variance].mean())
    return variance


def noise_from_residuals(
    signal: np.ndarray,
    residual: np.ndarray,
    *,
    read_variance: float,
    freedom_share: float,
    more: tuple[float, float] | None = None,
) -> NoiseModel:
    """Return the noise model that the residuals of a first fit show.

    ``signal`` is the model's height above black and ``residual`` the sample minus the model, in counts; ``freedom_share`` is
    degrees of freedom over samples; ``more`` is one more (height, variance) from elsewhere. Variances are taken bin by bin
    from medians, so that pixels that do not follow the model weigh little, and the two terms that grow with the signal are
    laid through them, neither below zero.
    """
    if len(signal) == 0:
        return NoiseModel(read_variance)
    brightest = float(np.quantile(signal, 0.999))
    # Beside a bright stripe even dark samples are noisier than far from it: glare, and the ringing of compressed photos.
    dark = residual[signal < max(np.sqrt(read_variance), DARK_SHARE * brightest)]
    if len(dark) >= FEWEST_IN_BIN:
        read_variance = max(read_variance, _clipped_variance(dark))
    edges = np.geomspace(max(np.sqrt(read_variance), brightest * 1e-3), brightest, SIGNAL_BINS + 1)
    places, variances = [], []
    # Most samples are dark: the others are looked through for every bin.
    lit = signal >= edges[0]
    signal, residual = signal[lit], residual[lit]
    for low, high in itertools.pairwise(edges):
        inside = (signal >= low) & (signal <= high)
        if np.count_nonzero(inside) >= FEWEST_IN_BIN:
            places.append(float(signal[inside].mean()))
            variances.append(float(np.median(residual[inside] ** 2)) / CHI_SQUARE_MEDIAN / freedom_share)
    if more is not None:
        places.append(more[0])
        variances.append(more[1])
    if len(places) < (3 if more is None else 1):
        return NoiseModel(read_variance)
    place, variance = np.array(places), np.array(variances)
    # Relative errors of the binned variances are alike, so each weighs by one over itself.
    weight = 1 / np.maximum(variance, ROUNDING_VARIANCE)
    terms = np.stack([place, place**2], axis=1) * weight[:, None]
    gain, relative_squared = _two_not_negative(terms, np.maximum(variance - read_variance, 0.0) * weight)
    return NoiseModel(read_variance, gain, float(np.sqrt(relative_squared)))


def _two_not_negative(terms: np.ndarray, wanted: np.ndarray) -> tuple[float, float]:
    """Return two factors, neither below zero, of the columns of ``terms`` [rows, 2] whose sum is nearest to ``wanted`` [rows].

    For two of them it is quickly said; SciPy's ``nnls``, for any number, would have every sweep load all of its optimisers.
    """
    both, _, rank, _ = np.linalg.lstsq(terms, wanted, rcond=None)
    if rank == 2 and (both >= 0).all():
        return float(both[0]), float(both[1])
    # Then the least lies on an edge, where one of the two is zero.
    square, pull = np.einsum("ij,ij->j", terms, terms), np.maximum(wanted @ terms, 0.0)
    factor = pull / np.maximum(square, np.finfo(np.float64).tiny)
    return (float(factor[0]), 0.0) if pull[0] * factor[0] >= pull[1] * factor[1] else (0.0, float(factor[1]))
