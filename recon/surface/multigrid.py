"""Algebraic multigrid by smoothed aggregation, as a preconditioner: one V-cycle of a hierarchy of ever coarser systems.

Vanek, Mandel and Brezina (1996). Coarse grids keep constants and do not join across weak connections: robust weights spread
over eight decades, and aggregates that ignore them need three times as many steps. Cycles run in single precision, which halves
the memory that they read; conjugate gradients around them make up for the rounding.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from recon.surface import vector_loops
from recon.surface.prolongation import prolongation
from recon.surface.sparse_product import product, rows_of

COARSEST_UNKNOWNS = 300
MOST_LEVELS = 12

Vector = Float64[np.ndarray, " unknowns"]


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """A system, its matrix as the smoother reads it, and the way to the next coarser one and back."""

    matrix: csr_array
    down: csr_array
    up: csr_array

    def rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the matrix as compiled loops read it."""
        return rows_of(self.matrix)

    def up_rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the way up likewise."""
        return rows_of(self.up)


@dataclass(frozen=True, slots=True, eq=False)
class Multigrid:
    """The hierarchy of a symmetric positive definite matrix."""

    levels: tuple[_Level, ...]
    coarsest: tuple[np.ndarray, bool]

    @classmethod
    def of(cls, matrix: csr_array, *, threads: int = 1) -> "Multigrid":
        """Coarsen until a system is small enough to be factorised; so many ``threads`` share it."""
        levels: list[_Level] = []
        exact = matrix
        while exact.shape[0] > COARSEST_UNKNOWNS and len(levels) < MOST_LEVELS:
            up = prolongation(exact)
            if not 0 < up.shape[1] < exact.shape[0]:
                break
            down = up.T.tocsr()
            levels.append(_Level(_single(exact), _single(down), _single(up)))
            # A part of a surface whose distance is hardly known beside its shape is nearly singular: coarse systems made in
            # single precision would not be definite.
            exact = product(down, product(exact, up, threads=threads), threads=threads)
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
        level, solution, left = self.levels[depth], np.empty_like(right), np.empty_like(right)
        vector_loops.descend(*level.rows(), right, solution, left)
        coarse = np.zeros(level.up.shape[1], np.float32)
        vector_loops.add_product(*rows_of(level.down), left, coarse)
        vector_loops.add_product(*level.up_rows(), self._cycle(depth + 1, coarse), solution)
        vector_loops.ascend(*level.rows(), right, solution)
        return solution


def _single(matrix: csr_array) -> csr_array:
    """Return a matrix in single precision, which shares its pattern."""
    return csr_array((matrix.data.astype(np.float32), matrix.indices, matrix.indptr), shape=matrix.shape)
