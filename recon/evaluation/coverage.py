"""Whether standard deviations are honest: how often an error lies within the 95 % interval that they promise."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.special import chdtri

# A normal errs in two tilts, about alike.
TILTS = 2.0
OUTSIDE = 0.05
DECILES = 10

PerPoint = Float64[np.ndarray, " points"]


def directions_alike(sd: PerPoint, across_sd: PerPoint) -> PerPoint:
    """Return in how many directions points err: (tr C)² / tr C² for the covariance C, k for k directions alike.

    ``sd`` is the root of its trace, ``across_sd`` that of its part across the surface; directions along it count as alike.

    Examples
    --------
    >>> directions_alike(np.array([1.0, 3**0.5, 1.0]), np.array([0.0, 1.0, 1.0])).round(6).tolist()
    [2.0, 3.0, 1.0]
    """
    across = np.minimum((across_sd / sd) ** 2, 1.0)
    return np.asarray(1 / (across**2 + (1 - across) ** 2 / 2))


def interval_95(directions: PerPoint) -> PerPoint:
    """Return the length within which 95 % of Gaussian errors are, over the root of their summed variances.

    That of so many directions alike, which has the same mean square and the same scatter of squares as the sum at hand
    (Satterthwaite 1946): at most 0.2 % of the errors more or fewer are within it. In two directions, √(−ln 0.05) = 1.73.

    Examples
    --------
    >>> interval_95(np.array([1.0, 2.0, 3.0])).round(2).tolist()
    [1.96, 1.73, 1.61]
    """
    return np.asarray(np.sqrt(chdtri(directions, OUTSIDE) / directions))


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
    error: PerPoint, sd: PerPoint, round_number: Int64[np.ndarray, " points"], *, directions: PerPoint | None = None
) -> Coverage:
    """Return the coverage of the lengths of errors.

    Parameters
    ----------
    error, sd
        Lengths of errors, and the roots of their summed variances.
    round_number
        Which independent draw of the noise each error is from, from 0.
    directions
        In how many directions they err (:func:`directions_alike`); two where it is not told, as of normals.

    Examples
    --------
    >>> one_round = np.zeros(20, np.int64)
    >>> [coverage_of(np.full(20, size), np.ones(20), one_round).whole.value for size in (1.7, 1.8)]
    [1.0, 0.0]
    """
    within = error <= interval_95(np.full(len(sd), TILTS) if directions is None else directions) * sd
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
