"""How errors are spread: the four figures that every table here gives."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Vectors = Float64[np.ndarray, "points 3"]


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean, median, root mean square and 95th percentile of the magnitude of ``count`` errors, in their own unit.

    All are NaN where there is nothing to judge.
    """

    count: int
    mean: float
    median: float
    rms: float
    p95: float


def spread_of(errors: Float64[np.ndarray, " points"]) -> Spread:
    """Summarise errors; their sign is dropped, and those that are NaN are left out."""
    size = np.abs(errors[np.isfinite(errors)])
    if not len(size):
        return Spread(0, np.nan, np.nan, np.nan, np.nan)
    median, p95 = np.quantile(size, [0.5, 0.95])
    return Spread(len(size), float(size.mean()), float(median), float(np.sqrt((size**2).mean())), float(p95))


def angle_between_rad(first: Vectors, second: Vectors) -> Float64[np.ndarray, " points"]:
    """Return the angle between unit vectors, 0 to π, so that a flipped normal counts as π.

    Kahan's formula: exact at both ends, where the arc cosine loses half its digits.
    """
    apart = np.linalg.norm(first - second, axis=1)
    along = np.linalg.norm(first + second, axis=1)
    return 2 * np.arctan2(apart, along)


def unit(vectors: Vectors) -> Vectors:
    """Return vectors of length 1 in the same directions; NaN for a vector of length 0."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.full_like(vectors, np.nan), where=length > 0)
