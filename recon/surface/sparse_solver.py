"""Solve a large sparse symmetric positive definite system: conjugate gradients with algebraic multigrid."""

from collections.abc import Callable

import numpy as np
import pyamg
from jaxtyping import Float64
from scipy.sparse import csr_array, csr_matrix, diags_array
from scipy.sparse.linalg import LinearOperator, cg, splu

from recon.errors import ReconError

RELATIVE_TOLERANCE = 1e-8
MOST_ITERATIONS = 500
# Vanek, Mandel and Brezina 1996: unknowns belong together where |a_ij| > θ √(a_ii a_jj), and what falls short of that is
# lumped into the diagonal before the prolongation is smoothed.
STRENGTH = ("symmetric", {"theta": 0.1})
# Gershgorin's bound, row by row, in place of the spectral radius, whose estimate costs twenty times all the rest.
SMOOTHING = ("jacobi", {"omega": 4 / 3, "weighting": "local", "filter_entries": True})
# So few equations are quicker to factorise than to prepare a multigrid for.
DIRECT_UNKNOWNS = 3000

Vector = Float64[np.ndarray, " unknowns"]


class SolverError(ReconError):
    """The system of equations of a surface could not be solved."""


def solver(matrix: csr_array, *, relative_tolerance: float = RELATIVE_TOLERANCE) -> Callable[[Vector, Vector], Vector]:
    """Prepare to solve ``matrix @ x = right``; the function returned takes the right side and a first guess.

    Smoothed-aggregation multigrid preconditions conjugate gradients until the residual, on a unit diagonal, is
    ``relative_tolerance`` of the right side. Small systems are factorised.
    """
    if matrix.shape[0] <= DIRECT_UNKNOWNS:
        return _direct(matrix)
    # The residual is measured on a unit diagonal, or the heaviest equations alone would decide when to stop.
    scale = 1 / np.sqrt(matrix.diagonal())
    scaled = (diags_array(scale) @ matrix @ diags_array(scale)).tocsr()
    multigrid = _multigrid(matrix)
    precondition = LinearOperator(scaled.shape, matvec=lambda residual: (multigrid @ (residual / scale)) / scale)

    def solve(right: Vector, guess: Vector) -> Vector:
        scaled_right = scale * right
        if not scaled_right.any():
            return np.zeros_like(right)
        solution, code = cg(
            scaled,
            scaled_right,
            x0=guess / scale,
            rtol=relative_tolerance,
            maxiter=MOST_ITERATIONS,
            M=precondition,
        )
        if code != 0 or not np.isfinite(solution).all():
            raise SolverError(
                f"the surface's {len(right)} equations did not converge in {MOST_ITERATIONS} steps; "
                "check the normals and their standard deviations, or use a tighter mask"
            )
        return solution * scale

    return solve


def _direct(matrix: csr_array) -> Callable[[Vector, Vector], Vector]:
    try:
        factors = splu(matrix.tocsc())
    except RuntimeError as error:
        raise SolverError(f"the surface's {matrix.shape[0]} equations are singular; use a tighter mask") from error
    return lambda right, _guess: factors.solve(right)


def _multigrid(matrix: csr_array) -> LinearOperator:
    """Smoothed aggregation, whose coarse grids keep constants and do not join across weak connections.

    Robust weights spread over eight decades. Ruge–Stüben multigrid on the diagonally scaled system stalls there, because
    scaling turns the slow errors from constants into something as rough as the weights; aggregates that ignore the
    weights need three times as many steps.
    """
    # pyamg knows only the older matrix class with 32-bit indices.
    older = csr_matrix(
        (matrix.data, matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)), shape=matrix.shape
    )
    levels = pyamg.smoothed_aggregation_solver(older, strength=STRENGTH, smooth=SMOOTHING, max_coarse=200)
    return levels.aspreconditioner(cycle="V")
