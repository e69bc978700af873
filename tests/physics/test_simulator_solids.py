"""Boolean combinations of simple bodies against the truth tables of sets, and crossings against closed forms."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_backend.optics.shapes import cone, cylinder, ellipsoid, half_space, slab, sphere
from sim_backend.optics.solids import Complement, Solid, contains, difference, intersection, union

numbers = st.floats(-2, 2)
triples = st.tuples(numbers, numbers, numbers)
radii = st.floats(0.3, 2)
directions = triples.filter(lambda v: np.linalg.norm(v) > 0.1)


def clipped_outside(centre: tuple[float, float, float], point: tuple[float, float, float]) -> Solid:
    return Complement(intersection(sphere(centre, 1), half_space(point, (0, 1, 1))))


def made_later(shape: Callable[..., Solid], *arguments: st.SearchStrategy) -> st.SearchStrategy:
    """Draw the dimensions only: run-time type checks draw random numbers, which a strategy must not."""
    return st.builds(partial, st.just(shape), *arguments)


makers = st.one_of(
    made_later(sphere, triples, radii),
    made_later(ellipsoid, triples, st.tuples(radii, radii, radii)),
    made_later(cylinder, triples, directions, radii),
    made_later(half_space, triples, directions),
    made_later(cone, triples, directions, radii),
    made_later(clipped_outside, triples, triples),
)
Maker = Callable[[], Solid]


def inside(solid: Solid, points: np.ndarray) -> np.ndarray:
    return contains(solid, points)


@settings(max_examples=60, deadline=None)
@given(makers, makers, st.integers(0, 2**31))
def test_combinations_hold_the_points_that_set_theory_gives_them(
    make_left: Maker, make_right: Maker, seed: int
) -> None:
    left, right = make_left(), make_right()
    points = np.random.default_rng(seed).uniform(-3, 3, (200, 3))
    a, b = inside(left, points), inside(right, points)
    np.testing.assert_array_equal(inside(union(left, right), points), a | b)
    np.testing.assert_array_equal(inside(intersection(left, right), points), a & b)
    np.testing.assert_array_equal(inside(difference(left, right), points), a & ~b)


@settings(max_examples=60, deadline=None)
@given(makers, makers, st.integers(0, 2**31))
def test_crossings_separate_inside_from_outside_along_a_ray(make_left: Maker, make_right: Maker, seed: int) -> None:
    left, right = make_left(), make_right()
    rng = np.random.default_rng(seed)
    origin, direction = rng.uniform(-3, 3, (50, 3)), rng.normal(size=(50, 3))
    solid = difference(left, right)
    found = solid.crossings(origin, direction)
    for place in rng.uniform(-4, 4, 5):
        parity = found.starts_inside ^ ((found.distance < place).sum(axis=1) % 2 == 1)
        np.testing.assert_array_equal(parity, inside(solid, origin + place * direction))


def test_crossings_ascend_and_lie_on_their_own_surface() -> None:
    rng = np.random.default_rng(5)
    rod = intersection(cylinder((0, 0, 0), (0, 0, 1), 1.0), *slab(-2, 2))
    solid = difference(rod, cone((0, 0, 0), (0, 0, 1), 0.4), sphere((0.9, 0, 0), 0.5))
    origin, direction = rng.uniform(-3, 3, (2000, 3)), rng.normal(size=(2000, 3))
    found = solid.crossings(origin, direction)
    with np.errstate(invalid="ignore"):
        assert not (np.diff(found.distance, axis=1) < 0).any()
    ray, column = np.nonzero(np.isfinite(found.distance))
    assert len(ray) > 500
    points = origin[ray] + found.distance[ray, column, None] * direction[ray]
    for number, leaf in enumerate(solid.leaves()):
        mine = found.surface[ray, column] == number
        # Far points lose digits in proportion to the square of their distance.
        np.testing.assert_allclose(leaf.value(points[mine]), 0, atol=1e-9)


def test_a_ray_through_the_middle_of_a_ball_meets_it_at_its_radius() -> None:
    direction = np.array([[0.6, 0.0, 0.8]])
    found = sphere((1, 2, 3), 2.5).crossings(np.array([[1.0, 2.0, 3.0]]) - 1e6 * direction, direction)
    np.testing.assert_allclose(found.distance[0], [1e6 - 2.5, 1e6 + 2.5], rtol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_a_ray_along_a_cylinder_stays_on_its_side(offset: float) -> None:
    found = cylinder((0, 0, 0), (0, 0, 1), 1.0).crossings(
        np.array([[offset, 0, 5.0], [1.5, 0, 5.0]]), np.array([[0.0, 0, 1], [0, 0, 1]])
    )
    assert not np.isfinite(found.distance).any()
    assert found.starts_inside.tolist() == [True, False]


def test_the_gradient_points_out_and_is_the_derivative_of_the_value() -> None:
    body = ellipsoid((0.5, -1, 2), (3, 2, 1))
    point, step = np.array([[1.0, 0.2, 1.5]]), 1e-6
    slope = [(body.value(point + step * axis) - body.value(point - step * axis))[0] / (2 * step) for axis in np.eye(3)]
    np.testing.assert_allclose(body.gradient(point)[0], slope, rtol=1e-8)
