"""Whether standard deviations are honest: how often an error lies within the 95 % interval that they promise."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

# The length of a Gaussian error in two directions alike, with the summed variance sd², exceeds r with the probability
# exp(−r²/sd²) (Rayleigh). A point errs along the surface, a normal in two tilts.
TWO_DIMENSIONS_95 = float(np.sqrt(-np.log(0.05)))
DECILES = 10


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of errors within their 95 % interval: of all, and of each tenth by standard deviation, the surest first."""

    whole: float
    by_decile: tuple[float, ...]


def coverage_of(error: Float64[np.ndarray, " points"], sd: Float64[np.ndarray, " points"]) -> Coverage:
    """Return the coverage of the lengths of two-dimensional errors; ``sd`` is the root of their summed variances.

    Examples
    --------
    >>> coverage_of(np.full(20, 1.7), np.ones(20)).whole, coverage_of(np.full(20, 1.8), np.ones(20)).whole
    (1.0, 0.0)
    """
    within = error <= TWO_DIMENSIONS_95 * sd
    if not len(within):
        return Coverage(np.nan, (np.nan,) * DECILES)
    tenths = np.array_split(within[np.argsort(sd, kind="stable")], DECILES)
    return Coverage(float(within.mean()), tuple(float(tenth.mean()) if len(tenth) else np.nan for tenth in tenths))
