"""Compiled loops over a sparse matrix and one right side: what conjugate gradients and their multigrid go through.

:mod:`recon.surface.block_loops` has those for several right sides at once.
"""

import numpy as np

from recon.compiled import compiled


@compiled
def descend(
    starts: np.ndarray,
    unknowns: np.ndarray,
    values: np.ndarray,
    right: np.ndarray,
    solution: np.ndarray,
    residual: np.ndarray,
) -> None:
    """Sweep forward through the unknowns from zero (Gauss and Seidel), and write what that leaves of the right side.

    What comes after each unknown leaves it. The matrix is symmetric, so that this is known as soon as the sweep gets there.
    """
    for row in range(len(starts) - 1):
        total, diagonal = right[row], np.float32(1.0)
        for place in range(starts[row], starts[row + 1]):
            other = unknowns[place]
            if other == row:
                diagonal = values[place]
            elif other < row:
                total -= values[place] * solution[other]
        total /= diagonal
        solution[row] = total
        residual[row] = 0.0
        for place in range(starts[row], starts[row + 1]):
            other = unknowns[place]
            if other < row:
                residual[other] -= values[place] * total


@compiled
def ascend(
    starts: np.ndarray, unknowns: np.ndarray, values: np.ndarray, right: np.ndarray, solution: np.ndarray
) -> None:
    """Sweep backward through the unknowns, in place."""
    for row in range(len(starts) - 2, -1, -1):
        total, diagonal = right[row], np.float32(1.0)
        for place in range(starts[row], starts[row + 1]):
            other = unknowns[place]
            if other == row:
                diagonal = values[place]
            else:
                total -= values[place] * solution[other]
        solution[row] = total / diagonal


@compiled
def add_product(
    starts: np.ndarray, unknowns: np.ndarray, values: np.ndarray, vector: np.ndarray, result: np.ndarray
) -> None:
    """Add the matrix's product with a vector, in place."""
    for row in range(len(starts) - 1):
        total = result[row]
        for place in range(starts[row], starts[row + 1]):
            total += values[place] * vector[unknowns[place]]
        result[row] = total


@compiled
def multiply(
    starts: np.ndarray,
    unknowns: np.ndarray,
    values: np.ndarray,
    search: np.ndarray,
    first: int,
    end: int,
    along: np.ndarray,
) -> None:
    """Write the matrix's product with a search direction, in the rows from ``first`` to before ``end``."""
    for row in range(first, end):
        total = 0.0
        for place in range(starts[row], starts[row + 1]):
            total += values[place] * search[unknowns[place]]
        along[row] = total


@compiled
def step(
    length: float,
    search: np.ndarray,
    along: np.ndarray,
    weight: np.ndarray,
    solution: np.ndarray,
    residual: np.ndarray,
) -> float:
    """Go along the search direction by a length, and return the weighted sum of squares of what is left."""
    squares = 0.0
    for row in range(len(search)):
        solution[row] += length * search[row]
        residual[row] -= length * along[row]
        squares += weight[row] * residual[row] ** 2
    return squares


@compiled
def turn(ratio: float, upward: np.ndarray, search: np.ndarray) -> None:
    """Turn the search direction."""
    for row in range(len(search)):
        search[row] = upward[row] + ratio * search[row]


@compiled
def dot_product(one: np.ndarray, other: np.ndarray) -> float:
    """Return the dot product in double precision, its terms in order."""
    dot = 0.0
    for row in range(len(one)):
        dot += one[row] * other[row]
    return dot
