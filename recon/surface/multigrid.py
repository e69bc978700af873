"""Algebraic multigrid by smoothed aggregation, as a preconditioner: one V-cycle of a hierarchy of ever coarser systems.

Vanek, Mandel and Brezina (1996). Coarse grids keep constants and do not join across weak connections: robust weights spread
over eight decades, and aggregates that ignore them need three times as many steps. Cycles run in single precision, which halves
the memory that they read; conjugate gradients around them make up for the rounding.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from pyamg import amg_core
from pyamg.aggregation.aggregate import standard_aggregation
from pyamg.strength import symmetric_strength_of_connection
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array, csr_matrix, diags_array

# Unknowns belong together where |a_ij| > θ √(a_ii a_jj); what falls short of that is lumped into the diagonal before the
# prolongation is smoothed.
STRENGTH_THETA = 0.1
# Gershgorin's bound, row by row, stands for the spectral radius of the Jacobi step.
JACOBI_OMEGA = 4 / 3
COARSEST_UNKNOWNS = 300
MOST_LEVELS = 12

Vector = Float64[np.ndarray, " unknowns"]


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """A system, its matrix as the smoother reads it, and the way to the next coarser one and back."""

    matrix: csr_array
    down: csr_array
    up: csr_array


@dataclass(frozen=True, slots=True, eq=False)
class Multigrid:
    """The hierarchy of a symmetric positive definite matrix."""

    levels: tuple[_Level, ...]
    coarsest: tuple[np.ndarray, bool]

    @classmethod
    def of(cls, matrix: csr_array) -> "Multigrid":
        """Coarsen until a system is small enough to be factorised."""
        levels: list[_Level] = []
        exact = matrix
        while exact.shape[0] > COARSEST_UNKNOWNS and len(levels) < MOST_LEVELS:
            here = exact.astype(np.float32)
            up = _prolongation(here)
            if not 0 < up.shape[1] < here.shape[0]:
                break
            down = up.T.tocsr()
            levels.append(_Level(here, down, up))
            # A part of a surface whose distance is hardly known beside its shape is nearly singular: coarse systems made in
            # single precision would not be definite.
            exact = (down.astype(np.float64) @ (exact @ up.astype(np.float64))).tocsr()
        dense = exact.toarray()
        # Unknowns that nothing joins are solved by the sweeps alone; where all are such, the one coarse unknown is that of none.
        alone = np.flatnonzero(dense.diagonal() == 0)
        dense[alone, alone] = 1.0
        return cls(tuple(levels), cho_factor(dense))

    def cycle(self, residual: Vector) -> Vector:
        """Return an approximate solution of the system for this right side: one symmetric V-cycle."""
        size = float(np.abs(residual).max())
        if not 0 < size < np.inf:
            return np.zeros_like(residual)
        # Single precision ends at 1e38, and residuals come in any unit.
        return self._cycle(0, (residual / size).astype(np.float32)).astype(np.float64) * size

    def _cycle(self, depth: int, right: np.ndarray) -> np.ndarray:
        if depth == len(self.levels):
            return cho_solve(self.coarsest, right.astype(np.float64), check_finite=False).astype(np.float32)
        level = self.levels[depth]
        matrix, solution = level.matrix, np.zeros_like(right)
        _sweep(matrix, solution, right, forward=True)
        solution += level.up @ self._cycle(depth + 1, level.down @ (right - matrix @ solution))
        _sweep(matrix, solution, right, forward=False)
        return solution


def _sweep(matrix: csr_array, solution: np.ndarray, right: np.ndarray, *, forward: bool) -> None:
    """Sweep once through the unknowns (Gauss and Seidel), in place."""
    last = len(solution)
    ends = (0, last, 1) if forward else (last - 1, -1, -1)
    amg_core.gauss_seidel(matrix.indptr, matrix.indices, matrix.data, solution, right, *ends)


def _prolongation(matrix: csr_array) -> csr_array:
    """Return how each unknown follows the aggregates: constant on its own, then smoothed by a Jacobi step."""
    # pyamg knows only the older matrix class with 32-bit indices.
    older = csr_matrix(
        (matrix.data, matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)), shape=matrix.shape
    )
    strong = symmetric_strength_of_connection(older, STRENGTH_THETA)
    aggregates = csr_array(standard_aggregation(strong)[0].astype(np.float32))
    kept = csr_array((np.ones(strong.nnz, np.float32), strong.indices, strong.indptr), shape=matrix.shape)
    filtered = kept.multiply(matrix).tocsr()
    lumped = matrix.sum(axis=1) - filtered.sum(axis=1)
    diagonal = filtered.diagonal() + lumped
    size = np.abs(filtered).sum(axis=1) - np.abs(filtered.diagonal()) + np.abs(diagonal)
    step = JACOBI_OMEGA / np.maximum(size, np.finfo(np.float32).tiny)
    smoothed = diags_array(step) @ (filtered @ aggregates + diags_array(lumped) @ aggregates)
    return (aggregates - smoothed).tocsr().astype(np.float32)
