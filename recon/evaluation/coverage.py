"""Whether standard deviations are honest: how often an error lies within the 95 % interval that they promise."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

# The length of a Gaussian error in two directions alike, with the summed variance sd², exceeds r with the probability
# exp(−r²/sd²) (Rayleigh). A point errs along the surface, a normal in two tilts.
TWO_DIMENSIONS_95 = float(np.sqrt(-np.log(0.05)))
DECILES = 10


@dataclass(frozen=True, slots=True)
class Share:
    """A share of errors that lie within their 95 % interval, and the standard deviation that sampling leaves to it.

    Errors of one round are correlated: neighbours share their noise. So the share scatters as rounds do, not as pixels. NaN
    where there is only one round.
    """

    value: float
    sd: float

    def outside(self, least: float, most: float) -> bool:
        """Tell whether the share misses these limits."""
        return not least <= self.value <= most

    def clearly_outside(self, least: float, most: float, *, sampling_sds: float) -> bool:
        """Tell whether it misses them by more than so many standard deviations of its sampling."""
        return max(least - self.value, self.value - most) > sampling_sds * self.sd


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of errors within their 95 % interval: of all, and of each tenth by standard deviation, the surest first."""

    whole: Share
    by_decile: tuple[Share, ...]


def coverage_of(
    error: Float64[np.ndarray, " points"],
    sd: Float64[np.ndarray, " points"],
    round_number: Int64[np.ndarray, " points"],
) -> Coverage:
    """Return the coverage of the lengths of two-dimensional errors.

    Parameters
    ----------
    error, sd
        Lengths of errors, and the roots of their summed variances.
    round_number
        Which independent draw of the noise each error is from, from 0.

    Examples
    --------
    >>> one_round = np.zeros(20, np.int64)
    >>> [coverage_of(np.full(20, size), np.ones(20), one_round).whole.value for size in (1.7, 1.8)]
    [1.0, 0.0]
    """
    within = error <= TWO_DIMENSIONS_95 * sd
    order = np.argsort(sd, kind="stable")
    tenths = (_share(within[part], round_number[part]) for part in np.array_split(order, DECILES))
    return Coverage(_share(within, round_number), tuple(tenths))


def _share(within: np.ndarray, round_number: np.ndarray) -> Share:
    """Return a ratio of sums over rounds, with its linearised standard deviation (Cochran, Sampling Techniques, 6.3)."""
    if not len(within):
        return Share(np.nan, np.nan)
    share = float(within.mean())
    apart = np.bincount(round_number, within - share)
    rounds = np.count_nonzero(np.bincount(round_number))
    if rounds < 2:
        return Share(share, np.nan)
    return Share(share, float(np.sqrt((apart**2).sum() * rounds / (rounds - 1))) / len(within))
