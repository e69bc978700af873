"""Heights from wanted steps between neighbours: the system of equations that all integrations of normals share."""

import numpy as np
from jaxtyping import Float64

from recon.surface.neighbours import Neighbours, components, normal_equations
from recon.surface.sparse_solver import RELATIVE_TOLERANCE, SparseSolver

PerPair = Float64[np.ndarray, " pairs"]
PerUnknown = Float64[np.ndarray, " unknowns"]


def heights_from_steps(
    graph: Neighbours,
    step: PerPair,
    weight: PerPair,
    *,
    guess: PerUnknown | None = None,
    relative_tolerance: float = RELATIVE_TOLERANCE,
    system: SparseSolver | None = None,
) -> PerUnknown:
    """Minimise Σ weight (h_second − h_first − step)²; one unknown of each connected part is held near 0.

    ``guess`` is where the solver begins, ``relative_tolerance`` where it stops. ``system`` keeps what the same graph with other
    weights can use again.
    """
    if not len(step):
        return np.zeros(graph.pixels)
    part = components(graph.pixels, graph.first, graph.second)
    held = np.zeros(graph.pixels)
    # The constant is free, so holding one unknown a part changes no difference of heights.
    held[np.unique(part, return_index=True)[1]] = 1.0
    ones = np.ones(len(step))
    matrix = normal_equations(graph, -ones, ones, weight, held)
    pull = weight * step
    right = np.bincount(graph.second, pull, minlength=graph.pixels)
    right -= np.bincount(graph.first, pull, minlength=graph.pixels)
    start = np.zeros(graph.pixels) if guess is None else guess - guess[held > 0][part]
    return (system or SparseSolver()).solver(matrix, relative_tolerance=relative_tolerance)(right, start)
