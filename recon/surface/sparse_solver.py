"""Solve a large sparse symmetric positive definite system: conjugate gradients with algebraic multigrid."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu

from recon.bands import over_bands
from recon.errors import ReconError
from recon.surface import vector_loops
from recon.surface.block_solver import Block, solved_block
from recon.surface.multigrid import Multigrid
from recon.surface.sparse_product import rows_of

RELATIVE_TOLERANCE = 1e-8
MOST_ITERATIONS = 500
# So few equations are quicker to factorise than to prepare a multigrid for.
DIRECT_UNKNOWNS = 3000
# With more steps than this, a hierarchy made for other weights costs more than a new one, which is made in as long as 17 take.
MOST_WITH_OTHER_WEIGHTS = 17

Vector = Float64[np.ndarray, " unknowns"]


class SolverError(ReconError):
    """The system of equations of a surface could not be solved."""


class SparseSolver:
    """Solves systems with one pattern, whose weights change little from one to the next: their multigrid is made once.

    So many ``threads`` share the products of matrices and vectors; the result is the same.
    """

    def __init__(self, *, threads: int = 1) -> None:
        self._multigrid: Multigrid | None = None
        self._threads = threads

    def solver(
        self, matrix: csr_array, *, relative_tolerance: float = RELATIVE_TOLERANCE, error_sd: float = 0.0
    ) -> Callable[[Vector, Vector], Vector]:
        """Prepare to solve ``matrix @ x = right``; the function returned takes the right side and a first guess.

        Multigrid preconditions conjugate gradients until the residual, on a unit diagonal, is ``relative_tolerance`` of the
        right side: the heaviest equations alone must not decide when to stop. Small systems are factorised.

        Where the matrix is the inverse of the unknowns' covariance, it is also enough that neither an unknown nor any
        combination of them is farther than ``error_sd`` of its own standard deviations from the solution, as estimated.
        """
        if matrix.shape[0] <= DIRECT_UNKNOWNS:
            return _direct(matrix)
        inverse_diagonal = 1 / matrix.diagonal()

        def solve(right: Vector, guess: Vector) -> Vector:
            inherited = self._multigrid is not None
            if self._multigrid is None:
                self._multigrid = Multigrid.of(matrix, threads=self._threads)
            steps = MOST_WITH_OTHER_WEIGHTS if inherited else MOST_ITERATIONS
            tolerance = relative_tolerance * np.sqrt(_square(right, inverse_diagonal))
            found, converged = _conjugate_gradients(
                matrix,
                right,
                guess,
                self._multigrid,
                inverse_diagonal,
                tolerance=tolerance,
                error_sd=error_sd,
                steps=steps,
                threads=self._threads,
            )
            if not converged and inherited:
                self._multigrid = Multigrid.of(matrix, threads=self._threads)
                found, converged = _conjugate_gradients(
                    matrix,
                    right,
                    found if np.isfinite(found).all() else guess,
                    self._multigrid,
                    inverse_diagonal,
                    tolerance=tolerance,
                    error_sd=error_sd,
                    steps=MOST_ITERATIONS,
                    threads=self._threads,
                )
            if not converged:
                raise SolverError(
                    f"the surface's {len(right)} equations did not converge in {MOST_ITERATIONS} steps; "
                    "check the normals and their standard deviations, or use a tighter mask"
                )
            return found

        return solve


def solver(
    matrix: csr_array, *, relative_tolerance: float = RELATIVE_TOLERANCE, error_sd: float = 0.0, threads: int = 1
) -> Callable[[Vector, Vector], Vector]:
    """Prepare to solve one system, as :meth:`SparseSolver.solver` does."""
    return SparseSolver(threads=threads).solver(matrix, relative_tolerance=relative_tolerance, error_sd=error_sd)


def block_solver(matrix: csr_array, *, relative_tolerance: float) -> Callable[[Block], Block]:
    """Prepare to solve for several right sides at once; the function returned may run in threads.

    Where they do not converge together, they are solved one by one.
    """
    if matrix.shape[0] <= DIRECT_UNKNOWNS:
        factorised = _direct(matrix)
        return lambda right: factorised(right.astype(np.float64), right).astype(np.float32)
    multigrid, weight = Multigrid.of(matrix), 1 / matrix.diagonal()

    def solve(right: Block) -> Block:
        found, converged = solved_block(
            matrix, right, multigrid, weight, relative_tolerance=relative_tolerance, steps=MOST_ITERATIONS
        )
        if converged:
            return found
        one_by_one = solver(matrix, relative_tolerance=relative_tolerance)
        columns = [one_by_one(column, np.zeros_like(column)) for column in right.T.astype(np.float64)]
        return np.stack(columns, axis=1).astype(np.float32)

    return solve


def _conjugate_gradients(
    matrix: csr_array,
    right: Vector,
    guess: Vector,
    multigrid: Multigrid,
    inverse_diagonal: Vector,
    *,
    tolerance: float,
    error_sd: float,
    steps: int,
    threads: int,
) -> tuple[Vector, bool]:
    """Return the solution, and whether its residual fell to ``tolerance`` (Hestenes and Stiefel 1952, preconditioned).

    An error's square in the matrix is that of the largest number of sd by which any combination of unknowns is off; residual
    times cycle estimates it.
    """
    if not right.any():
        return np.zeros_like(right), True
    solution = guess.copy()
    residual = right - _product(matrix, solution, threads=threads)
    search, product, squares = np.zeros_like(right), 1.0, _square(residual, inverse_diagonal)
    for _ in range(steps):
        if squares <= tolerance**2:
            return solution, True
        upward = multigrid.cycle(residual)
        before, product = product, vector_loops.dot_product(residual, upward)
        if 0 <= product <= error_sd**2:
            return solution, True
        vector_loops.turn(product / before, upward, search)
        along = _product(matrix, search, threads=threads)
        length = product / vector_loops.dot_product(search, along)
        if not np.isfinite(length):
            return solution, False
        squares = vector_loops.step(length, search, along, inverse_diagonal, solution, residual)
    return solution, bool(squares <= tolerance**2)


def _product(matrix: csr_array, vector: Vector, *, threads: int) -> Vector:
    rows, result = rows_of(matrix), np.empty_like(vector)

    def write(band: slice) -> None:
        vector_loops.multiply(*rows, vector, band.start, band.stop, result)

    over_bands(write, len(vector), threads=threads)
    return result


def _square(residual: Vector, inverse_diagonal: Vector) -> float:
    """Return the square of a residual's size on a unit diagonal. Not by BLAS, whose threads wait for those of other work."""
    return float(np.einsum("i,i,i->", residual, residual, inverse_diagonal))


def _direct(matrix: csr_array) -> Callable[[Vector, Vector], Vector]:
    try:
        factors = splu(matrix.tocsc())
    except RuntimeError as error:
        raise SolverError(f"the surface's {matrix.shape[0]} equations are singular; use a tighter mask") from error
    return lambda right, _guess: factors.solve(right)
