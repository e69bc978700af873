"""Integration against surfaces whose depth and normals are known in closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recon.surface.integration import (
    Integration,
    integrate_on_rays,
    integrate_orthographic,
    integrate_perspective,
)

FORMS: tuple[Integration, ...] = ("quadratic", "discrete", "bilateral")

ALONG_Z = np.array([0.0, 0.0, 1.0])
CENTRE_MM = np.array([0.0, 0.0, -100.0])


def grid(size: int, half_mm: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    axis = np.linspace(-half_mm, half_mm, size)
    x, y = np.meshgrid(axis, axis)
    return x, y


def origins(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([x, y, np.zeros_like(x)], axis=2)


def normals(slope_x: np.ndarray, slope_y: np.ndarray) -> np.ndarray:
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=2)
    return normal / np.linalg.norm(normal, axis=2, keepdims=True)


def disc(x: np.ndarray, y: np.ndarray, radius_mm: float) -> np.ndarray:
    return x**2 + y**2 < radius_mm**2


def without_mean(values: np.ndarray) -> np.ndarray:
    return values - np.nanmean(values)


@pytest.mark.parametrize("form", FORMS)
def test_tilted_plane_is_exact_in_parallel_rays(form: Integration) -> None:
    x, y = grid(21)
    depth = 0.7 * x - 1.9 * y + 3
    tilt = normals(np.full_like(x, 0.7), np.full_like(x, -1.9))
    mask = disc(x, y, 9)
    found = integrate_orthographic(
        tilt, mask, origin_mm=origins(x, y), direction=ALONG_Z, anchor_depth_mm=depth, integration=form
    )
    assert np.abs(found.depth_mm - depth)[mask].max() < 1e-6
    assert np.isnan(found.depth_mm[~mask]).all()


@pytest.mark.parametrize("form", FORMS)
def test_tilted_plane_is_exact_in_perspective(form: Integration) -> None:
    x, y = grid(21)
    direction = np.stack([x, y, np.full_like(x, 60.0)], axis=2)
    facing = np.array([0.3, -0.5, -1.0]) / np.linalg.norm([0.3, -0.5, -1.0])
    depth = (facing @ [0.0, 0.0, 100.0]) / (direction @ facing)
    tilt = np.broadcast_to(facing, direction.shape).copy()
    mask = disc(x, y, 9)
    found = integrate_perspective(
        tilt, mask, centre_mm=CENTRE_MM, direction=direction, anchor_depth_mm=depth, integration=form
    )
    assert np.abs(found.depth_mm / depth - 1)[mask].max() < 1e-6
    assert np.abs((found.point_mm @ facing)[mask]).max() < 1e-4


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("shown", [(slice(2, 3), slice(None)), (slice(2, 3), slice(3, 4)), (slice(0), slice(0))])
def test_one_row_one_pixel_and_none_are_integrated_without_a_fault(
    form: Integration, shown: tuple[slice, slice]
) -> None:
    x, y = grid(6)
    mask = np.zeros(x.shape, dtype=bool)
    mask[shown] = True
    facing, depth = np.broadcast_to(-ALONG_Z, (*x.shape, 3)).copy(), np.full(x.shape, 7.0)
    found = integrate_orthographic(
        facing, mask, origin_mm=origins(x, y), direction=ALONG_Z, anchor_depth_mm=depth, integration=form
    )
    known = np.isfinite(found.depth_mm)
    assert not known[~mask].any()
    assert found.depth_mm[known] == pytest.approx(7.0)


def test_sphere_is_exact_because_its_chords_are_normal_to_mean_normals() -> None:
    x, y = grid(41)
    depth = np.sqrt(15.0**2 - x**2 - y**2, where=disc(x, y, 12), out=np.full_like(x, np.nan))
    normal = np.stack([x, y, depth], axis=2) / 15.0
    found = integrate_orthographic(
        normal, np.ones(x.shape, bool), origin_mm=origins(x, y), direction=ALONG_Z, anchor_depth_mm=depth
    )
    inside = np.isfinite(depth)
    assert np.array_equal(np.isfinite(found.depth_mm), inside)
    assert np.abs(found.depth_mm - depth)[inside].max() < 1e-6


def test_error_on_a_wavy_surface_falls_with_the_square_of_the_spacing() -> None:
    worst = []
    for size in (41, 81):
        x, y = grid(size)
        depth = np.sin(0.5 * x) * np.cos(0.4 * y)
        slopes = 0.5 * np.cos(0.5 * x) * np.cos(0.4 * y), -0.4 * np.sin(0.5 * x) * np.sin(0.4 * y)
        found = integrate_orthographic(
            normals(*slopes), disc(x, y, 9.5), origin_mm=origins(x, y), direction=ALONG_Z, anchor_depth_mm=depth
        )
        worst.append(np.nanmax(np.abs(found.depth_mm - depth)))
    assert worst[1] < worst[0] / 3.5  # second order: a factor of 4 in the limit


def test_noise_of_normals_adds_up_along_a_line_as_a_random_walk() -> None:
    # On a flat line of N pixels, spacing s, the ends differ by s(ε_0/2 + ε_1 + … + ε_{N−1}/2): variance s²σ²(N − 1.5).
    lines, length, spacing_mm, sd_rad = 300, 40, 0.5, 1e-3
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(length) * spacing_mm, np.arange(2 * lines) * spacing_mm)
    mask = np.zeros(x.shape, bool)
    mask[::2] = True  # every second row: the lines do not touch
    normal = normals(sd_rad * rng.standard_normal(x.shape), np.zeros_like(x))
    found = integrate_orthographic(normal, mask, origin_mm=origins(x, y), direction=ALONG_Z)
    difference = (found.depth_mm[:, -1] - found.depth_mm[:, 0])[::2]
    expected = spacing_mm**2 * sd_rad**2 * (length - 1.5)
    # The variance of a sample variance of n Gaussian numbers is 2/n; 4 sigma.
    assert np.mean(difference**2) == pytest.approx(expected, rel=4 * np.sqrt(2 / lines))


def test_each_part_gets_its_own_constant() -> None:
    x, y = grid(20)
    depth = np.where(x < 0, 5.0, 50.0)
    mask = np.abs(x) > 1
    flat = normals(np.zeros_like(x), np.zeros_like(x))
    found = integrate_orthographic(flat, mask, origin_mm=origins(x, y), direction=ALONG_Z, anchor_depth_mm=depth)
    assert np.allclose(found.depth_mm[mask], depth[mask])
    assert set(np.unique(found.part)) == {-1, 0, 1}


def test_wrong_anchors_in_the_minority_do_not_move_the_surface() -> None:
    x, y = grid(20)
    flat = normals(np.zeros_like(x), np.zeros_like(x))
    anchor = np.full_like(x, 7.0)
    anchor[:8] = 1000.0
    anchor[8, :] = np.nan
    found = integrate_orthographic(
        flat, np.ones(x.shape, bool), origin_mm=origins(x, y), direction=ALONG_Z, anchor_depth_mm=anchor
    )
    assert np.allclose(found.depth_mm, 7.0)


def test_part_without_anchor_is_centred_on_zero() -> None:
    x, y = grid(20)
    tilt = normals(np.full_like(x, 0.2), np.zeros_like(x))
    found = integrate_orthographic(tilt, np.ones(x.shape, bool), origin_mm=origins(x, y), direction=ALONG_Z)
    assert np.allclose(found.depth_mm, without_mean(0.2 * x), atol=1e-6)


def test_pixel_seen_edge_on_becomes_a_part_of_its_own() -> None:
    x, y = grid(5)
    normal = normals(np.zeros_like(x), np.zeros_like(x))
    normal[2, 2] = [1.0, 0.0, -1.0]  # with its neighbours' normals, a mean at right angles to the line of sight
    normal[2, 2] /= np.sqrt(2)
    normal[2, 2, 2] = -1.0
    normal[2, 2, 0] = 0.0
    found = integrate_orthographic(normal, np.ones(x.shape, bool), origin_mm=origins(x, y), direction=ALONG_Z)
    assert len(np.unique(found.part)) == 2
    assert np.isfinite(found.depth_mm).all()


@settings(max_examples=15, deadline=None)
@given(scale=st.floats(1e-2, 1e2), seed=st.integers(0, 100))
def test_scaling_the_scene_scales_the_depth(scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = grid(15)
    normal = normals(*(0.3 * rng.standard_normal((2, 15, 15))))
    mask = rng.random((15, 15)) > 0.1
    one, other = (
        integrate_orthographic(normal, mask, origin_mm=origins(f * x, f * y), direction=ALONG_Z) for f in (1, scale)
    )
    assert np.allclose(other.depth_mm, scale * one.depth_mm, rtol=1e-5, atol=1e-5 * scale, equal_nan=True)


def test_transposing_the_photo_transposes_the_answer() -> None:
    rng = np.random.default_rng(3)
    x, y = grid(15)
    normal = normals(*(0.3 * rng.standard_normal((2, 15, 15))))
    mask = rng.random((15, 15)) > 0.1
    place = origins(x, y)
    found = integrate_orthographic(normal, mask, origin_mm=place, direction=ALONG_Z)
    turned = integrate_orthographic(
        np.swapaxes(normal, 0, 1), mask.T, origin_mm=np.swapaxes(place, 0, 1), direction=ALONG_Z
    )
    assert np.allclose(turned.depth_mm.T, found.depth_mm, atol=1e-6, equal_nan=True)


def test_empty_mask_gives_an_empty_surface() -> None:
    x, y = grid(5)
    flat = normals(np.zeros_like(x), np.zeros_like(x))
    found = integrate_orthographic(flat, np.zeros(x.shape, bool), origin_mm=origins(x, y), direction=ALONG_Z)
    assert np.isnan(found.depth_mm).all()
    assert (found.part == -1).all()


@pytest.mark.parametrize("form", ["quadratic", "discrete"])
def test_a_gentle_ripple_keeps_what_a_trapezium_leaves_of_it(form: Integration) -> None:
    # Depth rises from pixel to pixel by the mean of two slopes: of a wave of N pixels, (π/N) cot(π/N) is left.
    length_px, amplitude = 6, 1e-4
    x, y = np.meshgrid(np.arange(60.0), np.arange(12.0))
    wave = 2 * np.pi / length_px
    slope = amplitude * wave * np.cos(wave * x)
    found = integrate_orthographic(
        normals(slope, np.zeros_like(x)),
        np.ones(x.shape, bool),
        origin_mm=origins(x, y),
        direction=ALONG_Z,
        integration=form,
    )
    true = amplitude * np.sin(wave * x)
    left = (without_mean(found.depth_mm) * true).sum() / (true**2).sum()
    assert left == pytest.approx(np.pi / length_px / np.tan(np.pi / length_px), rel=1e-5)


def test_discrete_geometry_errs_with_the_square_of_the_spacing_on_a_ball() -> None:
    worst = []
    for size in (41, 81):
        x, y = grid(size)
        inside = disc(x, y, 12)
        depth = np.sqrt(15.0**2 - x**2 - y**2, where=inside, out=np.full_like(x, np.nan))
        found = integrate_orthographic(
            np.stack([x, y, depth], axis=2) / 15.0,
            inside,
            origin_mm=origins(x, y),
            direction=ALONG_Z,
            integration="discrete",
        )
        # The rim, where facets hang on one corner, is a pixel wide at either size.
        inner = disc(x, y, 9)
        worst.append(np.abs(without_mean((found.depth_mm - depth)[inner])).max())
    assert worst[1] < worst[0] / 3


def folded_sheet() -> tuple[np.ndarray, ...]:
    """A sheet cut along x = 0, y > 0: on the right it rises with y, so that the cut opens like a flap."""
    x, y = np.meshgrid(np.arange(-20, 20) + 0.5, np.arange(-20, 20) + 0.5)
    flap = (x > 0) & (y > 0)
    slope_y = np.where(flap, 0.8, 0.0)
    return x, y, slope_y * y, normals(np.zeros_like(x), slope_y)


def test_bilateral_weights_keep_a_jump_that_the_quadratic_form_smears() -> None:
    x, y, depth, normal = folded_sheet()
    mean_error = {}
    for form in FORMS:
        found = integrate_orthographic(
            normal,
            np.ones(x.shape, bool),
            origin_mm=origins(x, y),
            direction=ALONG_Z,
            anchor_depth_mm=depth,
            integration=form,
        )
        mean_error[form] = np.abs(found.depth_mm - depth).mean()
    # The flap rises to 15.6 pixels. The crease at its hinge is met half-way between pixels: 0.4 of the step there.
    assert mean_error["bilateral"] < 0.2
    assert min(mean_error["quadratic"], mean_error["discrete"]) > 1


@pytest.mark.parametrize("form", FORMS)
def test_on_rays_that_cross_a_plane_askew_its_places_are_exact(form: Integration) -> None:
    x, y = grid(21)
    # A saddle-shaped bundle: rays that meet in no point. The plane lies at 60 to 80 along them.
    direction = np.stack([0.012 * x, -0.008 * y, np.ones_like(x)], axis=2)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    facing = np.array([0.3, -0.5, 1.0]) / np.linalg.norm([0.3, -0.5, 1.0])
    depth = (facing @ [0.0, 0.0, 70.0] - origins(x, y) @ facing) / (direction @ facing)
    rng = np.random.default_rng(6)
    anchor = depth + 50 * rng.standard_normal(depth.shape)  # worthless, by its own sd
    sd = np.full(depth.shape, 50.0)
    anchor[4:8, 4:8], sd[4:8, 4:8] = depth[4:8, 4:8], 1e-3
    found = integrate_on_rays(
        np.broadcast_to(facing, direction.shape).copy(),
        np.ones(x.shape, bool),
        origin_mm=origins(x, y),
        direction=direction,
        anchor_distance_mm=anchor,
        anchor_sd_mm=sd,
        integration=form,
    )
    # Corners are half-way between rays, which on rays that do not meet is near the plane to second order: 1 % of the spacing.
    assert np.abs(found.point_mm @ facing - facing[2] * 70).max() < (1e-2 if form == "discrete" else 1e-3)


def test_a_few_anchors_that_look_surer_than_all_others_do_not_move_the_surface() -> None:
    x, y = grid(21)
    anchor, sd = np.full(x.shape, 70.0), np.full(x.shape, 2.0)
    # Two of 441 pixels would outweigh all others by far: 2 / 1e-6 against 439 / 4.
    anchor[0, [3, 9]], sd[0, [3, 9]] = 150.0, 1e-3
    found = integrate_on_rays(
        np.broadcast_to([0.0, 0.0, 1.0], (*x.shape, 3)).copy(),
        np.ones(x.shape, bool),
        origin_mm=origins(x, y),
        direction=np.broadcast_to([0.0, 0.0, 1.0], (*x.shape, 3)).copy(),
        anchor_distance_mm=anchor,
        anchor_sd_mm=sd,
    )
    np.testing.assert_allclose(found.point_mm[..., 2], 70.0, atol=1e-6)
