"""Refined points and normals against the simulator's own optics, with correspondences of known noise."""

from dataclasses import fields

import numpy as np
import pytest
from ray_field import crossed, exact_places, noisy_sweeps, scene_manifest
from scipy.ndimage import distance_transform_edt

from recon.evaluation.spread import angle_between_rad
from recon.maps import Maps, Support
from recon.method import Limits
from recon.reconstruct import cross_paths, maps_of
from recon.surface.height_patch import within_noise
from recon.surface.lateral_places import along_surface
from recon.surface.noise_reference import NoiseReference, depth_of, steadied, straight_depth_of
from recon.surface.path_measurement import PathMeasurement
from recon.surface.surface_stage import surface_of
from recon.surface.window_bias import ClearSlopes, Slopes, bias_left, own_slopes, without_bias
from recon.surface.window_means import replace_by_means, weighted_means
from recon.surface.window_quadratic import Lines, WindowFit, fit_windows
from sim_backend.scene import load_scene
from sim_backend.truth import Truth, compute_truth


@pytest.fixture(scope="module")
def hemisphere() -> tuple[Maps, Maps, Truth]:
    """Return the maps before and after the surface, and the truth, at 0.05 display pixels of noise."""
    scene = load_scene("hemisphere").resized(camera_columns=96)
    manifest = scene_manifest(scene)
    sweeps = noisy_sweeps(exact_places(scene), sd_px=0.05, rng=np.random.default_rng(4))
    maps, crossing = crossed(sweeps, manifest, "full")
    return maps, surface_of(maps, crossing, manifest, method="full").maps, compute_truth(scene)


def _fits(
    p: np.ndarray, q: np.ndarray, height: np.ndarray, weight: np.ndarray, *, half_widths: tuple[int, ...]
) -> list[WindowFit]:
    """Fit heights of which there are no draws, and read the polynomials at their own pixels."""
    none = np.empty((0, *p.shape), np.float32)
    return fit_windows(p, q, height, none, weight, Lines.upright(p, q), half_widths=half_widths, readings=1)


def test_quadratic_polynomials_are_found_exactly() -> None:
    q, p = np.indices((12, 15)) / 4.0 - 1.5
    height = 0.3 - 0.2 * p + 0.7 * q + 0.1 * p * p - 0.4 * p * q + 0.25 * q * q
    draws = np.stack([2 * height, -height]).astype(np.float32)
    lines = Lines.upright(p + 0.1, q - 0.05)
    (fit,) = fit_windows(p, q, height, draws, np.ones(p.shape), lines, half_widths=(2,), readings=3)
    p, q = p + 0.1, q - 0.05
    value = 0.3 - 0.2 * p + 0.7 * q + 0.1 * p * p - 0.4 * p * q + 0.25 * q * q
    slope_p, slope_q = -0.2 + 0.2 * p - 0.4 * q, 0.7 - 0.4 * p + 0.5 * q
    assert np.allclose(fit.along, value, atol=1e-9)
    assert np.allclose(fit.slope_p, slope_p, atol=1e-8)
    assert np.allclose(fit.slope_q, slope_q, atol=1e-8)
    # Draws come in single precision.
    for number, scale in enumerate((2, -1)):
        for read, expected in zip(fit.drawn, (value, slope_p, slope_q), strict=True):
            assert np.allclose(read[number], scale * expected, atol=1e-5)
    assert fit.misfit.max() < 1e-9
    assert fit.drawn_misfit.max() < 1e-9


def test_a_slanting_line_meets_its_polynomial_where_the_quadratic_equation_says() -> None:
    q, p = np.indices((9, 9)) / 4.0 - 1.0
    start = np.stack([p, q, np.full(p.shape, 2.0)], axis=-1)
    fits = fit_windows(
        *(p, q, 0.1 * p * p, np.empty((0, 9, 9), np.float32), np.ones(p.shape)),
        Lines(start, np.array([0.6, 0.0, -0.8])),
        half_widths=(2, 3),
        readings=1,
    )
    # 2 − 0.8 t = 0.1 (p + 0.6 t)²
    a, b, c = 0.036, 0.8 + 0.12 * p, 0.1 * p * p - 2
    for fit in fits:
        assert np.allclose(fit.along, (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a), rtol=1e-6)


def test_a_path_that_shifts_meets_the_surface_where_path_and_plane_still_cross() -> None:
    rng = np.random.default_rng(11)
    direction, normal = (unit / np.linalg.norm(unit) for unit in ([0.1, -0.3, -1.0], [0.4, 0.2, 1.0]))
    root = rng.standard_normal((3, 3))
    # A path through d along V crosses the plane n · x = 0 at d − V (n · d) / (n · V).
    move = np.eye(3) - np.outer(direction, normal) / (normal @ direction)
    found = along_surface((root @ root.T)[None], direction[None], normal[None])[0]
    assert np.allclose(found, move @ root @ (move @ root).T, rtol=1e-12)


def test_windows_at_an_edge_are_fitted_as_least_squares_over_the_pixels_inside() -> None:
    rng = np.random.default_rng(7)
    q, p = np.indices((10, 11)) / 4.0 - 1.2
    height, weight = rng.standard_normal(p.shape), rng.uniform(0.5, 2.0, p.shape) * (rng.uniform(size=p.shape) < 0.9)
    widths = (2, 3, 4)
    for half, fit in zip(widths, _fits(p, q, height, weight, half_widths=widths), strict=True):
        for row, col in ((0, 0), (1, 9), (5, 5), (9, 3)):
            part = (slice(max(row - half, 0), row + half + 1), slice(max(col - half, 0), col + half + 1))
            root, places, values = (each[part].ravel() for each in (np.sqrt(weight), (p + 1j * q), height))
            x, y = places.real, places.imag
            terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
            expected, misfit, *_ = np.linalg.lstsq(root[:, None] * terms, root * values)
            assert np.allclose(fit.coefficients[:, row, col], expected, rtol=1e-6, atol=1e-8)
            assert fit.misfit[row, col] == pytest.approx(misfit[0], rel=1e-8)
            assert fit.count[row, col] == np.count_nonzero(root)


def test_variance_in_the_middle_of_a_window_is_that_of_the_closed_form() -> None:
    # Savitzky and Golay in two dimensions: the middle of 5 × 5 places has the weight 27/175.
    q, p = np.indices((9, 9)) - 4.0
    (fit,) = _fits(p, q, np.zeros((9, 9)), np.ones((9, 9)), half_widths=(2,))
    assert fit.variance[0, 4, 4] == pytest.approx(27 / 175, rel=1e-9)


def test_windows_and_maps_wider_than_there_is_room_for_in_a_row_are_refused() -> None:
    flat, wide = np.zeros((9, 9)), np.zeros((9, 73))
    with pytest.raises(ValueError, match="may reach 4 pixels, not 5"):
        _fits(flat, flat, flat, flat, half_widths=(2, 5))
    with pytest.raises(ValueError, match="may be 72 pixels wide, not 73"):
        _fits(wide, wide, wide, wide, half_widths=(2,))


def test_slopes_of_a_surface_that_bends_ever_more_lose_the_bias_of_their_window() -> None:
    q, p = np.indices((41, 41)) - 20.0
    trust, cubic = np.ones(p.shape), 1e-3 * p**3
    small, large = (
        Slopes(np.stack([fit.slope_p, 0 * p]), np.zeros((2, 1, *p.shape), np.float32), np.ones(p.shape))
        for fit in _fits(p, q, cubic, trust, half_widths=(2, 4))
    )
    true = 3e-3 * p**2
    depth_px, within = np.full(p.shape, 99.0), trust > 0
    clear, left, _ = without_bias(large, as_fitted(small), trust, depth_px, depth_px, within, half_width=4, smaller=2)
    assert large.slope[0, 20, 20] - true[20, 20] == pytest.approx(1e-3 * 11.8, rel=1e-9)
    assert clear.slope[0, 20, 20] == pytest.approx(true[20, 20], abs=1e-12)
    assert left[0, 20, 20] == pytest.approx(0, abs=1e-12)
    measured = as_fitted(Slopes(np.stack([true, 0 * p]), np.zeros((2, 1, *p.shape), np.float32), 0 * p))
    clear, left, _ = without_bias(large, measured, trust, depth_px, depth_px, within, half_width=4, smaller=0)
    assert clear.slope[0, 20, 20] == pytest.approx(true[20, 20], abs=1e-12)
    assert left[0, 20, 20] == pytest.approx(0, abs=1e-12)


def test_a_window_held_against_measured_normals_keeps_the_mean_of_their_noise_and_says_so() -> None:
    rng = np.random.default_rng(1)
    noise_sd, shape = 0.05, (41, 41)
    measured = as_fitted(
        Slopes(
            noise_sd * rng.standard_normal((2, *shape)),
            (noise_sd * rng.standard_normal((2, 12, *shape))).astype(np.float32),
            np.zeros(shape),
        )
    )
    # The true slopes are 0, and the window is off by a fixed amount, without noise.
    window = Slopes(np.full((2, *shape), 0.2), np.zeros((2, 12, *shape), np.float32), np.ones(shape))
    deep = np.full(shape, 99.0)
    clear, _, _ = without_bias(window, measured, np.ones(shape), deep, deep, deep > 0, half_width=1, smaller=0)
    # A mean over 9 × 9; over the inner 33² pixels of two slopes lie some 26 that know nothing of each other.
    inner = np.s_[..., 4:37, 4:37]
    assert np.mean(clear.slope[inner] ** 2) == pytest.approx(noise_sd**2 / 81, rel=3 * np.sqrt(2 / 26))
    assert np.mean(clear.drawn[inner] ** 2) == pytest.approx(noise_sd**2 / 81, rel=3 * np.sqrt(2 / (12 * 26)))


def test_a_pixels_own_normal_turns_in_draws_as_much_as_the_covariance_of_its_paths_says() -> None:
    scene = load_scene("hemisphere").resized(camera_columns=24)
    _, crossing = crossed(
        noisy_sweeps(exact_places(scene), sd_px=0.05, rng=np.random.default_rng(4)), scene_manifest(scene), "full"
    )
    crossing = crossing.on_surface()
    shape, everywhere = (scene.camera.rows, scene.camera.columns), np.ones(len(crossing.pixels), dtype=bool)
    paths = PathMeasurement.of(crossing, everywhere, shape=shape, n_liquid=1.3355, n_air=1.0)
    distance = paths.on_grid(crossing.points.distance_liquid_mm, everywhere)
    draw, rng = paths.noise_at(distance, np.isfinite(distance)), np.random.default_rng(5)
    square = np.mean([(draw(rng)[3].astype(float) ** 2).sum(axis=1) for _ in range(200)], axis=0)
    # Of two tilts in 200 draws, over all pixels.
    ratio = np.mean(square / crossing.normal_sd_rad**2)
    assert ratio == pytest.approx(1, abs=4 / np.sqrt(200 * len(square)) + 0.01)


def test_slopes_of_measured_normals_change_with_them_as_a_small_turn_does() -> None:
    rng = np.random.default_rng(2)
    normal = np.array([0.3, -0.4, 1.0]) + 0.3 * rng.standard_normal((5, 6, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    turn = 1e-4 * np.cross(rng.standard_normal((5, 6, 3)), normal)
    mask = np.ones((5, 6), dtype=bool)
    none = np.zeros((3, 0, 5, 6), np.float32)
    before, after = (own_slopes(each, none, mask).clear.slope for each in (normal, normal + turn))
    drawn = own_slopes(normal, np.moveaxis(turn, -1, 0)[:, None].astype(np.float32), mask).clear.drawn[:, 0]
    assert np.allclose(drawn, after - before, rtol=1e-2, atol=1e-6)


def test_where_the_rim_runs_aslant_the_bias_is_taken_off_at_each_pixels_own_distance_from_it() -> None:
    q, p = np.indices((40, 60)) * 1.0
    mask = 2 * q + p > 50
    depth_px, straight_px = depth_of(mask), straight_depth_of(mask)
    ring = (depth_px == 3) & (p > 8) & (p < 44)
    assert straight_px[ring].std() > 0.2
    # A bias that falls by as much from pixel to pixel; that of windows of one and two pixels is as 1 to 3.4.
    bias = np.where(mask, 0.3 - 0.02 * straight_px, 0.0)
    nothing = np.zeros((2, 1, *mask.shape), np.float32)
    small, large = (
        Slopes(np.stack([share * bias, 0 * bias]), nothing, np.ones(mask.shape)) for share in (1 / 3.4, 1.0)
    )
    one = mask.astype(np.float64)
    off = [
        without_bias(large, as_fitted(small), one, depth_px, far, mask, half_width=2, smaller=1)[0].slope[0, ring]
        for far in (straight_px, depth_px)
    ]
    assert np.abs(off[0]).max() < 0.02 * 0.05
    assert off[1].std() > 0.02 * 0.2


def test_straight_distances_from_the_rim_are_roots_of_whole_numbers_wherever_in_memory_the_map_lies() -> None:
    # Odd widths put every row, and each map that is held on to the next one, at another place.
    held = []
    for cols in range(41, 61):
        down, right = np.indices((48, cols))
        mask = (down - 23.3) ** 2 + (right - cols / 2) ** 2 < 19.7**2
        held.append(straight_depth_of(mask))
        assert np.array_equal(held[-1], distance_transform_edt(mask))


def test_a_window_that_the_rim_cuts_is_held_against_the_smaller_one_where_that_is_whole() -> None:
    small, before, large = (everywhere(slope) for slope in (0.0, 0.02, 0.1))
    mask, ones = np.ones((20, 20), dtype=bool), np.ones((20, 20))
    depth_px = depth_of(np.pad(mask, 1))[1:-1, 1:-1]
    both_cut, held = depth_px <= 2, (depth_px > 2) & (depth_px <= 4)
    # Six pixels in, the windows differ by twice as much; that is none of the cut ones' business.
    for slopes in (large.slope, large.drawn):
        slopes[..., depth_px > 5] *= 2
    known = ClearSlopes(small, before, 0.01 * ones)
    clear, left, left_drawn = without_bias(large, known, ones, depth_px, depth_px, mask, half_width=4, smaller=2)
    for found, over in ((clear.slope, left), (clear.drawn, left_drawn)):
        assert np.allclose(found[..., both_cut], 0.1)
        assert np.allclose(over[..., both_cut], 0.1 * 11.8 / (11.8 - 3.4), rtol=0.1)
        assert np.allclose(found[..., held], 0.02)
        assert np.allclose(over[..., held], 0.0, atol=1e-7)
    nothing = np.zeros(mask.shape)
    told = bias_left(nothing, nothing, known, mask, depth_px, half_width=4, smaller=2)
    assert np.allclose(told[held], 0.01)
    assert np.allclose(told[~held], 0.0)


def test_what_is_left_of_the_bias_is_told_without_the_noise_in_it() -> None:
    rng = np.random.default_rng(0)
    bias, noise_sd, pixels = 0.01, 0.02, 33**2
    fields = noise_sd * rng.standard_normal((5, 67, 67))
    square, noise_square = (bias + fields[0]) ** 2, (fields[1:] ** 2).mean(axis=0)
    mask, depth_px = np.ones(square.shape, dtype=bool), np.full(square.shape, 99.0)
    before = as_fitted(everywhere(0.0, size=67))
    told = bias_left(square, noise_square, before, mask, depth_px, half_width=4, smaller=2)
    # Var (b + e)² = 4 b² s² + 2 s⁴; four draws add 2 s⁴ / 4.
    sd = np.sqrt((4 * bias**2 * noise_sd**2 + 2.5 * noise_sd**4) / pixels)
    assert told[33, 33] == pytest.approx(bias**2, abs=3 * sd)
    assert 3 * sd < noise_sd**2


def test_what_is_left_of_the_bias_is_told_by_pixels_as_deep() -> None:
    mask = np.ones((80, 80), dtype=bool)
    depth_px = depth_of(np.pad(mask, 1))[1:-1, 1:-1]
    square, nothing = 100.0**-depth_px, np.zeros(mask.shape)
    told = bias_left(square, nothing, as_fitted(everywhere(0.0, size=80)), mask, depth_px, half_width=4, smaller=2)
    # Beyond the windows' reach of the rim, too, it is that of the same depth, or of up to three pixels farther out.
    for depth in (5, 9, 12, 20):
        there = depth_px == depth
        assert (told[there] > 0.2 * square[there]).all()
        assert (told[there] <= 100.0 ** -(depth - 3)).all()


def test_a_window_is_left_where_most_about_it_leave_more_than_noise_or_it_far_more_itself() -> None:
    beyond = np.full((40, 40), 0.5)
    beyond[:, 20:] = 3.0
    # A straight crease stays where it is, up to the edge of the map.
    assert np.array_equal(within_noise(beyond), beyond < 1)
    beyond[:] = 0.5
    beyond[10, 10], beyond[30, 30], beyond[20, 20] = 1.2, 2.0, np.nan
    held = within_noise(beyond)
    assert held[10, 10]
    assert not held[30, 30]
    assert not held[20, 20]
    assert held.sum() == held.size - 2


def test_shares_of_noise_are_those_of_the_tiles_about_each() -> None:
    def told(count: float, total: float) -> np.ndarray:
        return np.array([[[count], [total]]], dtype=float)

    larger = steadied({(0, 0): told(100, 50), (1, 1): told(300, 90), (0, 3): told(10, 7), (5, 5): told(0, 0)})
    # (50 + 90) / (100 + 300) = 0.35, in place of 0.5 and 0.3.
    assert larger[0, 0][0, 0] == pytest.approx(0.7)
    assert larger[1, 1][0, 0] == pytest.approx(0.35 / 0.3)
    assert larger[0, 3][0, 0] == larger[5, 5][0, 0] == 1.0


def everywhere(slope: float, *, size: int = 20) -> Slopes:
    """Return the same slopes at every pixel, and in a draw."""
    shape = (size, size)
    return Slopes(np.full((2, *shape), slope), np.full((2, 1, *shape), slope, np.float32), np.ones(shape))


def as_fitted(slopes: Slopes) -> ClearSlopes:
    return ClearSlopes(slopes, slopes, np.zeros(slopes.variance.shape))


@pytest.mark.parametrize("window_px", [5, 9, 17, 33])
def test_weighted_means_are_those_of_the_window_within_the_map(window_px: int) -> None:
    rng = np.random.default_rng(3)
    fields = rng.standard_normal((2, 12, 23))
    weight = rng.uniform(0.5, 2.0, (12, 23)) * (rng.uniform(size=(12, 23)) < 0.7)
    fields[0, weight == 0] = np.nan
    means, reach = weighted_means(fields, weight, window_px=window_px), window_px // 2
    single = weighted_means(fields.astype(np.float32), weight, window_px=window_px)
    for row, col in ((0, 0), (5, 11), (11, 4), (3, 22)):
        part = (slice(max(row - reach, 0), row + reach + 1), slice(max(col - reach, 0), col + reach + 1))
        expected = [np.average(np.nan_to_num(field)[part], weights=weight[part]) for field in fields]
        assert np.allclose(means[:, row, col], expected, rtol=1e-12)
        assert np.allclose(single[:, row, col], expected, atol=1e-6)
    assert (weighted_means(fields, 0 * weight, window_px=window_px) == 0).all()


def test_means_over_a_window_of_another_width_are_refused() -> None:
    with pytest.raises(ValueError, match="pixels wide, not 7"):
        weighted_means(np.zeros((2, 9, 9)), np.ones((9, 9)), window_px=7)


def test_means_that_would_be_written_into_a_copy_are_refused() -> None:
    fields, ones = np.zeros((2, 3, 9, 9)), np.ones((9, 9))
    with pytest.raises(ValueError, match="copy"):
        replace_by_means(fields, ones, ones > 0, np.asfortranarray(fields), window_px=5)


def test_few_draws_tell_the_noise_of_windows_to_a_per_cent_where_it_is_a_share_of_what_went_in() -> None:
    rng = np.random.default_rng(0)
    mask = np.ones((72, 72), dtype=bool)
    turn_sd_rad = np.linspace(1e-3, 3e-3, 72) * np.ones((72, 1))
    true = 0.04 * turn_sd_rad**2
    squares = true * rng.chisquare(12, mask.shape) / 12
    depth_px = np.full(mask.shape, 99.0)
    told = NoiseReference(turn_sd_rad, depth_px, mask).smoothed(squares, np.ones(mask.shape), mask, half_width=4)
    # 72² pixels of 12 draws: √(2 / 12) / 72 = 0.6 %.
    assert np.allclose(told, true, rtol=3 * 0.006)
    # A window beyond all numbers speaks for no other.
    squares[30, 40], squares[50, 20] = np.nan, np.inf
    reference = NoiseReference(turn_sd_rad, depth_px, mask)
    assert np.allclose(reference.smoothed(squares, np.ones(mask.shape), mask, half_width=4), true, rtol=3 * 0.006)
    assert np.isfinite(reference.told).all()


def test_refined_normals_and_points_are_far_better_than_measured_ones(hemisphere: tuple[Maps, Maps, Truth]) -> None:
    before, after, truth = hemisphere
    both = before.valid() & after.valid() & (truth.status == 0)
    turned = [np.median(angle_between_rad(maps.normal[both], truth.normal[both])) for maps in (before, after)]
    away = [np.median(np.linalg.norm((maps.point_mm - truth.point_mm)[both], axis=1)) for maps in (before, after)]
    # 25 places hold a quadratic polynomial's value to √(27/175) = 0.39 of one place's sd, 81 places to 0.21.
    assert turned[1] < turned[0] / 2
    assert away[1] < away[0] / 4


def test_points_are_as_far_off_as_their_standard_deviations_say(hemisphere: tuple[Maps, Maps, Truth]) -> None:
    _, after, truth = hemisphere
    judged = after.valid() & (truth.status == 0)
    error = np.linalg.norm((after.point_mm - truth.point_mm)[judged], axis=1)
    assert np.sqrt(np.mean((error / after.sd_mm[judged]) ** 2)) == pytest.approx(1.0, abs=0.15)


def test_normals_are_as_far_off_as_their_standard_deviations_say(hemisphere: tuple[Maps, Maps, Truth]) -> None:
    _, after, truth = hemisphere
    assert after.normal_sd_rad is not None
    judged = after.valid() & (truth.status == 0)
    ratio = angle_between_rad(after.normal[judged], truth.normal[judged]) / after.normal_sd_rad[judged]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.15)
    assert np.mean(ratio < np.sqrt(-np.log(0.05))) == pytest.approx(0.95, abs=0.02)


def test_a_surface_is_the_same_to_the_last_bit_however_many_threads_share_it() -> None:
    scene = load_scene("hemisphere").resized(camera_columns=72)
    manifest = scene_manifest(scene)
    sweeps = noisy_sweeps(exact_places(scene), sd_px=0.05, rng=np.random.default_rng(4))
    surfaces = []
    for threads in (1, 3):
        status, crossing = cross_paths(sweeps, manifest, method="full", limits=Limits(), threads=threads)
        maps = maps_of(status, crossing, shape=(scene.camera.rows, scene.camera.columns), method="full")
        surfaces.append(surface_of(maps, crossing, manifest, method="full", threads=threads).maps)
    one, other = surfaces
    assert one.valid().any()
    for field in fields(Maps):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_pixels_with_parallel_paths_are_marked_as_carried_by_their_neighbours(
    hemisphere: tuple[Maps, Maps, Truth],
) -> None:
    before, after, _ = hemisphere
    assert after.support is not None
    carried = after.valid() & ~before.valid()
    assert carried.any()
    assert (after.support[carried] == Support.NEIGHBOURS_ONLY).all()
    assert (after.support[before.valid() & after.valid()] == Support.OWN_CROSSING).all()
    assert (after.support[~after.valid()] == Support.NONE).all()
