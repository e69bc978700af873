"""One sparse symmetric positive definite system for several right sides at once.

Conjugate gradients for each, in lockstep and preconditioned by the same multigrid cycle. The cycle is in single precision.
What is around it is not: over millions of pixels the product with a long wave is as small as single precision's rounding.
"""

import numpy as np
from jaxtyping import Float32, Float64
from scipy.linalg import cho_solve
from scipy.sparse import csr_array

from recon.surface import block_loops
from recon.surface.block_loops import COLUMNS
from recon.surface.multigrid import Multigrid

Block = Float32[np.ndarray, "unknowns columns"]
DoubleBlock = Float64[np.ndarray, "unknowns columns"]


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
    rows = (matrix.indptr, matrix.indices, matrix.data)
    residual = right.astype(np.float64)
    solution, search, along = (np.zeros_like(residual) for _ in range(3))
    nothing = np.zeros(COLUMNS)
    squares = block_loops.step(nothing, search, along, weight, solution, residual)
    tolerance, product = relative_tolerance**2 * squares, np.ones(COLUMNS)
    for _ in range(steps):
        if (squares <= tolerance).all():
            return solution.astype(np.float32), True
        upward = _cycled(multigrid, residual)
        before, product = product, block_loops.dot_products(residual, upward)
        block_loops.turn(_ratio(product, before), upward, search)
        length = _ratio(product, block_loops.multiply(*rows, search, along))
        if not np.isfinite(length).all():
            return solution.astype(np.float32), False
        squares = block_loops.step(length, search, along, weight, solution, residual)
    return solution.astype(np.float32), bool((squares <= tolerance).all())


def _ratio(above: Float64[np.ndarray, " columns"], below: Float64[np.ndarray, " columns"]) -> np.ndarray:
    """Return the ratio, 0 for a column that is solved to the last digit."""
    return np.divide(above, below, out=np.zeros(COLUMNS), where=below != 0)


def _cycled(multigrid: Multigrid, residual: DoubleBlock) -> DoubleBlock:
    """Return an approximate solution for these right sides: one symmetric V-cycle, in which the longest column has length 1."""
    size = np.abs(residual).max(axis=0)
    scale = np.where((size > 0) & np.isfinite(size), size, 1.0)
    return _cycle(multigrid, 0, (residual / scale).astype(np.float32)) * scale


def _cycle(multigrid: Multigrid, depth: int, right: Block) -> Block:
    if depth == len(multigrid.levels):
        return cho_solve(multigrid.coarsest, right.astype(np.float64), check_finite=False).astype(np.float32)
    level = multigrid.levels[depth]
    rows = (level.matrix.indptr, level.matrix.indices, level.matrix.data)
    up = (level.up.indptr, level.up.indices, level.up.data)
    solution, residual = np.empty_like(right), np.empty_like(right)
    coarse = np.empty((level.up.shape[1], COLUMNS), np.float32)
    block_loops.descend(*rows, right, solution, residual)
    block_loops.restrict(*up, residual, coarse)
    block_loops.prolong(*up, _cycle(multigrid, depth + 1, coarse), solution)
    block_loops.ascend(*rows, right, solution)
    return solution
