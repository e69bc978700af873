"""How unknowns follow the aggregates that they are gathered into: constant on each, then smoothed by a Jacobi step."""

import numpy as np
from pyamg import amg_core
from scipy.sparse import csr_array

from recon.compiled import compiled

# Unknowns belong together where |a_ij| > θ √(a_ii a_jj); what falls short of that is lumped into the diagonal before the
# prolongation is smoothed.
STRENGTH_THETA = 0.1
# Gershgorin's bound, row by row, stands for the spectral radius of the Jacobi step.
JACOBI_OMEGA = 4 / 3
TINY = float(np.finfo(np.float32).tiny)


def prolongation(matrix: csr_array) -> csr_array:
    """Return the weights with which each unknown of a symmetric system follows the aggregates (Vanek, Mandel, Brezina 1996).

    Where no unknown belongs to another, there is one aggregate of none.
    """
    unknowns = matrix.shape[0]
    rows = (matrix.indptr, matrix.indices, matrix.data)
    diagonal = matrix.diagonal()
    starts, strong, share = np.zeros(unknowns + 1, np.int32), np.empty(matrix.nnz, np.int32), np.empty(matrix.nnz)
    _write_strong(*rows, diagonal, STRENGTH_THETA**2, JACOBI_OMEGA, starts, strong, share)
    aggregate, roots = np.empty(unknowns, np.int32), np.empty(unknowns, np.int32)
    aggregates = int(amg_core.standard_aggregation(unknowns, starts, strong, aggregate, roots))
    if aggregates == 0:
        aggregate[:] = -1
    up_starts, followed, weight = np.zeros(unknowns + 1, np.int32), np.empty(starts[-1], np.int32), np.empty(starts[-1])
    _write_prolongation(starts, strong, share, aggregate, up_starts, followed, weight)
    entries = up_starts[-1]
    return csr_array((weight[:entries], followed[:entries], up_starts), shape=(unknowns, max(aggregates, 1)))


@compiled
def _write_strong(
    starts: np.ndarray,
    unknowns: np.ndarray,
    values: np.ndarray,
    diagonal: np.ndarray,
    theta_squared: float,
    omega: float,
    strong_starts: np.ndarray,
    strong: np.ndarray,
    share: np.ndarray,
) -> None:
    """Write to which unknowns each belongs, itself first, and what share a Jacobi step takes from each of them."""
    end = 0
    for row in range(len(starts) - 1):
        own, first, size, middle = diagonal[row], end, 0.0, 0.0
        strong[first] = row
        end += 1
        for place in range(starts[row], starts[row + 1]):
            other, value = unknowns[place], values[place]
            if other != row and value * value > theta_squared * own * diagonal[other]:
                strong[end], share[end] = other, value
                size += abs(value)
                end += 1
            else:
                middle += value
        step = omega / max(size + abs(middle), TINY)
        share[first] = 1.0 - step * middle
        for place in range(first + 1, end):
            share[place] *= -step
        strong_starts[row + 1] = end


@compiled
def _write_prolongation(
    starts: np.ndarray,
    strong: np.ndarray,
    share: np.ndarray,
    aggregate: np.ndarray,
    up_starts: np.ndarray,
    followed: np.ndarray,
    weight: np.ndarray,
) -> None:
    """Write which aggregates each unknown follows, and how much: the sum of the shares of the unknowns in each."""
    end = 0
    for row in range(len(starts) - 1):
        first = end
        for place in range(starts[row], starts[row + 1]):
            to = aggregate[strong[place]]
            if to >= 0:
                found = first
                while found < end and followed[found] != to:
                    found += 1
                if found == end:
                    followed[end], weight[end] = to, 0.0
                    end += 1
                weight[found] += share[place]
        up_starts[row + 1] = end
