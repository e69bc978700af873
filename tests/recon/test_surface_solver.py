"""The multigrid solver against systems whose solution is known."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from recon.surface import sparse_solver
from recon.surface.block_solver import solved_block
from recon.surface.multigrid import Multigrid
from recon.surface.neighbours import neighbours_of, normal_equations
from recon.surface.sparse_product import product, rows_of
from recon.surface.sparse_solver import SolverError, solver


def system(size: int) -> tuple[csr_array, np.ndarray, np.ndarray]:
    """A Poisson-like system with couplings over three decades, and its solution."""
    rng = np.random.default_rng(1)
    graph = neighbours_of(np.hypot(*np.mgrid[-1 : 1 : size * 1j, -1 : 1 : size * 1j]) < 1)
    pairs = len(graph.first)
    matrix = normal_equations(
        graph, -np.ones(pairs), np.ones(pairs), 10 ** rng.uniform(-3, 0, pairs), np.full(graph.pixels, 1e-3)
    )
    solution = rng.standard_normal(graph.pixels)
    return matrix, matrix @ solution, solution


def test_multigrid_finds_the_solution() -> None:
    matrix, right, solution = system(100)
    assert len(right) > sparse_solver.DIRECT_UNKNOWNS
    assert np.abs(solver(matrix)(right, np.zeros_like(right)) - solution).max() < 1e-4


def test_islands_that_are_hardly_held_beside_their_stiffness_are_solved() -> None:
    rng = np.random.default_rng(3)
    row, column = np.mgrid[:120, :120]
    graph = neighbours_of((row % 6 > 0) & (column % 6 > 0))
    pairs = len(graph.first)
    matrix = normal_equations(
        graph, -np.ones(pairs), np.ones(pairs), 10 ** rng.uniform(0, 3, pairs), np.full(graph.pixels, 1e-7)
    )
    assert graph.pixels > sparse_solver.DIRECT_UNKNOWNS
    solution = rng.standard_normal(graph.pixels)
    found = solver(matrix)(matrix @ solution, np.zeros_like(solution))
    # Where an island lies is nearly lost in the rounding of the right side; its shape is not.
    island = (row // 6 * 20 + column // 6)[(row % 6 > 0) & (column % 6 > 0)]
    off = found - solution
    mean = np.bincount(island, off) / np.bincount(island)
    assert np.abs(off - mean[island]).max() < 1e-4


def test_small_system_is_solved_to_rounding() -> None:
    matrix, right, solution = system(20)
    assert np.abs(solver(matrix)(right, np.zeros_like(right)) - solution).max() < 1e-10


def test_right_side_of_zeros_gives_zeros() -> None:
    matrix, right, _ = system(100)
    assert not solver(matrix)(np.zeros_like(right), np.ones_like(right)).any()


def test_no_convergence_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sparse_solver, "MOST_ITERATIONS", 1)
    matrix, right, _ = system(100)
    with pytest.raises(SolverError, match="did not converge"):
        solver(matrix)(right, np.zeros_like(right))


def test_singular_system_is_one_sentence() -> None:
    with pytest.raises(SolverError, match="singular"):
        solver(csr_array(np.array([[1.0, -1.0], [-1.0, 1.0]])))


def test_right_side_that_is_not_a_number_is_one_sentence() -> None:
    matrix, right, _ = system(100)
    right[0] = np.nan
    with pytest.raises(SolverError, match="did not converge"):
        solver(matrix)(right, np.zeros_like(right))


def test_long_waves_of_several_right_sides_are_found_though_single_precision_cannot_see_their_product() -> None:
    size = 300
    graph = neighbours_of(np.ones((size, size), bool))
    pairs = len(graph.first)
    # Beside its stiffness, 4, a pixel is held by less than what single precision tells apart from that.
    matrix = normal_equations(graph, -np.ones(pairs), np.ones(pairs), np.ones(pairs), np.full(graph.pixels, 1e-7))
    along = (np.arange(size * size) // size + 0.5) * np.pi / size
    solutions = np.stack([np.cos(waves * along) for waves in range(4)], axis=1)
    # A cosine that is level at both ends is an eigenvector: 4 sin²(k/2) of it is left by the differences (Strang 1999).
    sizes = 4 * np.sin(np.arange(4) * np.pi / size / 2) ** 2 + 1e-7
    right = (solutions * sizes).astype(np.float32)
    found, converged = solved_block(
        matrix, right, Multigrid.of(matrix), 1 / matrix.diagonal(), relative_tolerance=1e-3, steps=60
    )
    assert converged
    assert np.abs(found - solutions).max() < 0.01


@pytest.mark.parametrize("threads", [1, 3])
def test_a_product_of_sparse_matrices_is_that_of_whole_ones_whatever_the_threads(threads: int) -> None:
    rng = np.random.default_rng(7)
    one, other = (
        csr_array(np.where(rng.random(shape) < 0.1, rng.standard_normal(shape), 0.0)) for shape in ((90, 70), (70, 40))
    )
    found = product(one, other, threads=threads)
    assert np.allclose(found.toarray(), one.toarray() @ other.toarray(), atol=1e-14)
    alone = product(one, other)
    assert all(np.array_equal(a, b) for a, b in zip(rows_of(found), rows_of(alone), strict=True))


def test_threads_change_no_bit_of_a_solution() -> None:
    matrix, right, _ = system(100)
    alone, shared = (solver(matrix, threads=threads)(right, np.zeros_like(right)) for threads in (1, 2))
    assert np.array_equal(alone, shared)
