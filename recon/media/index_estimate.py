"""An index with its standard deviation, and the statistics that both ways of measuring it share."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

NORMAL_CONSISTENT_MAD = 1.4826
# Geman and McClure's loss (1987) with this width keeps 95 % of the efficiency of least squares for Gaussian noise.
LOSS_WIDTH_SD = 3.787
# A variance from fewer groups means nothing.
FEWEST_GROUPS = 4


@dataclass(frozen=True, slots=True)
class IndexEstimate:
    """A refractive index, its standard deviation, and how many pixels it comes from."""

    n: float
    sd: float
    pixels: int


def robust_weights(residual: Float64[np.ndarray, " equations"]) -> Float64[np.ndarray, " equations"]:
    """Return weights from 1 towards 0 for residuals far beyond the others' scatter."""
    scale = NORMAL_CONSISTENT_MAD * float(np.median(np.abs(residual)))
    if scale == 0:
        return np.ones_like(residual)
    return (1 + (residual / (LOSS_WIDTH_SD * scale)) ** 2) ** -2


def scatter_covariance(
    regressors: Float64[np.ndarray, "equations unknowns"],
    instruments: Float64[np.ndarray, "equations unknowns"],
    residual: Float64[np.ndarray, " equations"],
    patch: Int64[np.ndarray, " equations"],
) -> Float64[np.ndarray, "unknowns unknowns"]:
    """Return the covariance of an answer by weighted instruments; errors are alike within a patch (Liang and Zeger 1986)."""
    bread = np.linalg.inv(instruments.T @ regressors)
    pull = instruments * residual[:, None]
    count = int(patch.max()) + 1
    summed = np.stack([np.bincount(patch, pull[:, k], count) for k in range(pull.shape[1])], axis=1)
    return bread @ (summed.T @ summed) @ bread.T


def variance_by_bands(
    regressors: Float64[np.ndarray, "equations unknowns"],
    instruments: Float64[np.ndarray, "equations unknowns"],
    residual: Float64[np.ndarray, " equations"],
    *,
    row: Int64[np.ndarray, " equations"],
    column: Int64[np.ndarray, " equations"],
) -> float:
    """Return the variance of the first unknown where errors are alike along rows and along columns of the photo.

    Pixels of one row, and of one column, see the same pixels of the display: two ways of clustering (Cameron, Gelbach and Miller
    2011, equation 2.7), and no less than any of its parts.
    """
    by_row, by_column, by_both = (
        float(scatter_covariance(regressors, instruments, residual, group)[0, 0])
        for group in (row, column, row * (int(column.max()) + 1) + column)
    )
    return max(by_row + by_column - by_both, by_row, by_column, by_both)


def variance_by_leaving_out(
    regressors: Float64[np.ndarray, "equations unknowns"],
    instruments: Float64[np.ndarray, "equations unknowns"],
    right: Float64[np.ndarray, " equations"],
    group: Int64[np.ndarray, " equations"],
) -> float:
    """Return the variance of the first unknown by the jackknife over groups (Efron 1982, chapter 3).

    Where a few groups have most of the lever they draw the answer to themselves, and their residuals no longer show their errors:
    only leaving them out does.
    """
    count = int(group.max()) + 1
    unknowns = range(regressors.shape[1])
    matrix = np.array(
        [[np.bincount(group, instruments[:, i] * regressors[:, k], count) for k in unknowns] for i in unknowns]
    )
    vector = np.array([np.bincount(group, instruments[:, i] * right, count) for i in unknowns])
    there = np.flatnonzero(np.bincount(group, minlength=count))
    if len(there) < FEWEST_GROUPS:
        return 0.0
    without = (matrix.sum(axis=2)[..., None] - matrix)[..., there], (vector.sum(axis=1)[:, None] - vector)[:, there]
    answers = np.linalg.solve(np.moveaxis(without[0], 2, 0), without[1].T[..., None])[:, 0, 0]
    return float((len(there) - 1) * answers.var())
