"""Compiled loops over a sparse matrix and several right sides at once: one pass over the matrix serves all of them.

Right sides and solutions lie with their columns side by side, one row an unknown: in single precision within a cycle of
multigrid, in double precision around it. How many columns there are is known when the loops are compiled, so that a core takes
all of them in one step.
"""

import numpy as np

from recon.compiled import compiled

COLUMNS = 4


@compiled
def descend(
    starts: np.ndarray,
    unknowns: np.ndarray,
    values: np.ndarray,
    right: np.ndarray,
    solution: np.ndarray,
    residual: np.ndarray,
) -> None:
    """Sweep forward through the unknowns from zero (Gauss and Seidel), and write what that leaves of the right sides.

    What comes after each unknown leaves it. The matrix is symmetric, so that this is known as soon as the sweep gets there.
    """
    total = np.empty(COLUMNS, np.float32)
    for row in range(len(starts) - 1):
        for k in range(COLUMNS):
            total[k] = right[row, k]
            residual[row, k] = 0.0
        diagonal = np.float32(1.0)
        for place in range(starts[row], starts[row + 1]):
            other = unknowns[place]
            if other == row:
                diagonal = values[place]
            elif other < row:
                for k in range(COLUMNS):
                    total[k] -= values[place] * solution[other, k]
        for k in range(COLUMNS):
            total[k] /= diagonal
            solution[row, k] = total[k]
        for place in range(starts[row], starts[row + 1]):
            other = unknowns[place]
            if other < row:
                for k in range(COLUMNS):
                    residual[other, k] -= values[place] * total[k]


@compiled
def ascend(
    starts: np.ndarray, unknowns: np.ndarray, values: np.ndarray, right: np.ndarray, solution: np.ndarray
) -> None:
    """Sweep backward through the unknowns, in place."""
    total = np.empty(COLUMNS, np.float32)
    for row in range(len(starts) - 2, -1, -1):
        for k in range(COLUMNS):
            total[k] = right[row, k]
        diagonal = np.float32(1.0)
        for place in range(starts[row], starts[row + 1]):
            other = unknowns[place]
            if other == row:
                diagonal = values[place]
            else:
                for k in range(COLUMNS):
                    total[k] -= values[place] * solution[other, k]
        for k in range(COLUMNS):
            solution[row, k] = total[k] / diagonal


@compiled
def restrict(
    starts: np.ndarray, unknowns: np.ndarray, values: np.ndarray, residual: np.ndarray, coarse: np.ndarray
) -> None:
    """Write the residual as the coarser system sees it: the transposed prolongation's product."""
    coarse[:] = 0.0
    for row in range(len(starts) - 1):
        for place in range(starts[row], starts[row + 1]):
            for k in range(COLUMNS):
                coarse[unknowns[place], k] += values[place] * residual[row, k]


@compiled
def prolong(
    starts: np.ndarray, unknowns: np.ndarray, values: np.ndarray, coarse: np.ndarray, solution: np.ndarray
) -> None:
    """Add what the coarser system found, in place."""
    for row in range(len(starts) - 1):
        for place in range(starts[row], starts[row + 1]):
            for k in range(COLUMNS):
                solution[row, k] += values[place] * coarse[unknowns[place], k]


@compiled
def multiply(
    starts: np.ndarray, unknowns: np.ndarray, values: np.ndarray, search: np.ndarray, along: np.ndarray
) -> np.ndarray:
    """Write the matrix's product with a search direction, and return the dot product of both, a column each."""
    dot, total = np.zeros(COLUMNS), np.empty(COLUMNS)
    for row in range(len(starts) - 1):
        for k in range(COLUMNS):
            total[k] = 0.0
        for place in range(starts[row], starts[row + 1]):
            for k in range(COLUMNS):
                total[k] += values[place] * search[unknowns[place], k]
        for k in range(COLUMNS):
            along[row, k] = total[k]
            dot[k] += total[k] * search[row, k]
    return dot


@compiled
def step(
    length: np.ndarray,
    search: np.ndarray,
    along: np.ndarray,
    weight: np.ndarray,
    smaller: np.ndarray,
    solution: np.ndarray,
    residual: np.ndarray,
    right: np.ndarray,
) -> np.ndarray:
    """Go along the search direction by a length a column, and return the weighted sum of squares of what is left of each.

    What is left, ``smaller`` by a factor a column, is the right side of the next cycle of multigrid.
    """
    squares = np.zeros(COLUMNS)
    for row in range(len(search)):
        for k in range(COLUMNS):
            solution[row, k] += length[k] * search[row, k]
            residual[row, k] -= length[k] * along[row, k]
            squares[k] += weight[row] * residual[row, k] ** 2
            right[row, k] = smaller[k] * residual[row, k]
    return squares


@compiled
def turn(ratio: np.ndarray, upward: np.ndarray, search: np.ndarray) -> None:
    """Turn the search direction, by a ratio a column."""
    for row in range(len(search)):
        for k in range(COLUMNS):
            search[row, k] = upward[row, k] + ratio[k] * search[row, k]


@compiled
def dot_products(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the dot product of each column with that of another block."""
    dot = np.zeros(COLUMNS)
    for row in range(len(one)):
        for k in range(COLUMNS):
            dot[k] += one[row, k] * other[row, k]
    return dot
