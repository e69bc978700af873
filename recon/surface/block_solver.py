"""One sparse symmetric positive definite system for several right sides at once.

Conjugate gradients for each, in lockstep and preconditioned by the same multigrid cycle. The cycle is in single precision.
What is around it is not: over millions of pixels the product with a long wave is as small as single precision's rounding of what
it is the sum of. The products themselves and the solution may be rounded.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64
from scipy.linalg import cho_solve
from scipy.sparse import csr_array

from recon.surface import block_loops
from recon.surface.block_loops import COLUMNS
from recon.surface.multigrid import Multigrid
from recon.surface.sparse_product import rows_of

Block = Float32[np.ndarray, "unknowns columns"]


def solved_block(
    matrix: csr_array,
    right: Block,
    multigrid: Multigrid,
    weight: Float64[np.ndarray, " unknowns"],
    *,
    relative_tolerance: float,
    steps: int,
) -> tuple[Block, bool]:
    """Return the solutions, and whether all their residuals fell to ``relative_tolerance`` of the right sides.

    ``weight`` is how much an equation counts in that: one over its diagonal.
    """
    assert right.shape[1] == COLUMNS
    rows = rows_of(matrix)
    residual = right.astype(np.float64)
    search = np.zeros_like(residual)
    solution, along = np.zeros_like(right), np.zeros_like(right)
    cycle = _Cycle.of(multigrid)
    # Single precision ends at 1e38, and right sides come in any unit. Conjugate gradients do not see by what constant their
    # preconditioner is multiplied.
    size = np.maximum(right.max(axis=0, initial=0.0), -right.min(axis=0, initial=0.0)).astype(np.float64)
    smaller = 1 / np.where((size > 0) & np.isfinite(size), size, 1.0)
    move = (search, along, weight, smaller, solution, residual, cycle.right)
    squares = block_loops.step(np.zeros(COLUMNS), *move)
    tolerance, product = relative_tolerance**2 * squares, np.ones(COLUMNS)
    for _ in range(steps):
        if (squares <= tolerance).all():
            return solution, True
        upward = cycle.solution()
        before, product = product, block_loops.dot_products(residual, upward)
        block_loops.turn(_ratio(product, before), upward, search)
        length = _ratio(product, block_loops.multiply(*rows, search, along))
        if not np.isfinite(length).all():
            return solution, False
        squares = block_loops.step(length, *move)
    return solution, bool((squares <= tolerance).all())


def _ratio(above: Float64[np.ndarray, " columns"], below: Float64[np.ndarray, " columns"]) -> np.ndarray:
    """Return the ratio, 0 for a column that is solved to the last digit."""
    return np.divide(above, below, out=np.zeros(COLUMNS), where=below != 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Cycle:
    """A multigrid with room for right sides, solutions and what these leave, from the finest system to the coarsest."""

    multigrid: Multigrid
    rights: tuple[np.ndarray, ...]
    solutions: tuple[np.ndarray, ...]
    left: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, multigrid: Multigrid) -> "_Cycle":
        """Make room: a block that is taken anew for every cycle costs as much as what is done with it."""
        sizes = [level.matrix.shape[0] for level in multigrid.levels]
        coarsest = len(multigrid.coarsest[0])
        rights, solutions, left = (
            tuple(np.empty((size, COLUMNS), np.float32) for size in of) for of in ([*sizes, coarsest], sizes, sizes)
        )
        return cls(multigrid, rights, solutions, left)

    @property
    def right(self) -> Block:
        """Where the right sides are put."""
        return self.rights[0]

    def solution(self) -> Block:
        """Return an approximate solution for them, which the next cycle overwrites: one symmetric V-cycle."""
        return self._from(0)

    def _from(self, depth: int) -> Block:
        right = self.rights[depth]
        if depth == len(self.multigrid.levels):
            return cho_solve(self.multigrid.coarsest, right.astype(np.float64), check_finite=False).astype(np.float32)
        level, solution, left = self.multigrid.levels[depth], self.solutions[depth], self.left[depth]
        rows, up = level.rows(), level.up_rows()
        block_loops.descend(*rows, right, solution, left)
        block_loops.restrict(*up, left, self.rights[depth + 1])
        block_loops.prolong(*up, self._from(depth + 1), solution)
        block_loops.ascend(*rows, right, solution)
        return solution
