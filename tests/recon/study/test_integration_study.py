"""The surfaces of the benchmark of integration: their normals are those of their depth, in parallel and in perspective."""

import numpy as np
import pytest

from recon.study.integration_study import depth_error_mm
from recon.study.true_surfaces import (
    PINHOLE,
    SURFACES,
    TrueSurface,
    grid_of,
    normals_of,
    seen_in_parallel,
    seen_in_perspective,
    with_noise,
)

STEP = 1e-6


@pytest.mark.parametrize("surface", SURFACES, ids=lambda one: one.name)
def test_slopes_are_the_derivatives_of_depth(surface: TrueSurface) -> None:
    x, y = grid_of(40)
    inner = surface.seen(x, y) & surface.seen(1.01 * x, 1.01 * y)
    along_x = (surface.depth(x + STEP, y) - surface.depth(x - STEP, y)) / (2 * STEP)
    along_y = (surface.depth(x, y + STEP) - surface.depth(x, y - STEP)) / (2 * STEP)
    # Of an even grid, no pixel's centre lies on a crease or a cut.
    slope_x, slope_y = surface.slopes(x, y)
    np.testing.assert_allclose(slope_x[inner], along_x[inner], atol=1e-6)
    np.testing.assert_allclose(slope_y[inner], along_y[inner], atol=1e-6)


@pytest.mark.parametrize("surface", SURFACES, ids=lambda one: one.name)
def test_a_ray_from_the_pinhole_ends_on_the_surface(surface: TrueSurface) -> None:
    view = seen_in_perspective(surface, 40)
    assert view.mask.mean() > 0.3
    point = (view.depth[..., None] * view.direction)[view.mask]
    np.testing.assert_allclose(point[:, 2], PINHOLE + surface.depth(point[:, :1], point[:, 1:2])[:, 0], atol=1e-9)


def test_noise_tilts_normals_by_as_much_as_was_asked() -> None:
    flat = seen_in_parallel(SURFACES[1], 60)
    tilted = with_noise(flat, sd_rad=0.01, rng=np.random.default_rng(3))
    squares = ((tilted.normal - flat.normal) ** 2).sum(axis=2)
    # Two tilts of variance σ² each; the mean of 7,200 squares is known to √(2 / 7200).
    assert squares.mean() == pytest.approx(2 * 0.01**2, rel=4 * np.sqrt(2 / 7200))


def test_the_error_is_that_of_a_trapezium_on_a_slope_that_is_linear() -> None:
    # On z = x² the mean of two slopes is the chord's: nothing is lost, but in unit normals, whose mean is not their slopes'.
    x, y = grid_of(30)
    view = seen_in_parallel(SURFACES[1], 30)
    gentle = 1e-3
    exact = type(view)(
        depth=gentle * x**2,
        normal=normals_of(2 * gentle * x, 0 * y),
        mask=view.mask,
        origin=view.origin,
        direction=view.direction,
    )
    assert depth_error_mm(exact, "quadratic") < 1e-6
    assert depth_error_mm(exact, "discrete") < 1e-6
