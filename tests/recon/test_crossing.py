"""Light paths, where they cross, and the normals that follow: against closed forms written here."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.geometry.entry_point import entry_points
from recon.geometry.light_paths import LightPaths, light_paths
from recon.geometry.normals import normals_from_angles, normals_from_paths
from recon.sessions.manifest import CoverGlass, Pose

X, Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
NEAR = Pose(centre_mm=(0.0, 0.0, 10.0), x_axis=X, y_axis=Y)
FAR = Pose(centre_mm=(0.0, 0.0, 20.0), x_axis=X, y_axis=Y)


def refract(direction: np.ndarray, normal: np.ndarray, n_from: float, n_to: float) -> np.ndarray:
    """Snell's law in vector form, written independently: keep the tangential part times the index."""
    tangential = direction - (direction * normal).sum(1, keepdims=True) * normal
    tangential = tangential * n_from / n_to
    along = np.sqrt(1 - (tangential**2).sum(1, keepdims=True))
    return tangential + along * normal * np.sign((direction * normal).sum(1, keepdims=True))


def paths_through(
    point: np.ndarray, direction: np.ndarray, sd_mm: float, rng: np.random.Generator | None = None
) -> LightPaths:
    """Make the paths whose lines run through ``point`` with ``direction`` (towards −z), with noise if asked."""
    screens = []
    for z in (10.0, 20.0):
        hit = point + ((z - point[:, 2]) / direction[:, 2])[:, None] * direction
        noise = 0.0 if rng is None else rng.normal(0, sd_mm, (len(point), 2))
        screens.append(hit[:, :2] + noise)
    sd = np.full((len(point), 2), sd_mm)
    return light_paths((screens[0], screens[1]), (sd, sd), (NEAR, FAR), cover_glass=None, n_medium=1.0)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def bundle(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    point = np.column_stack([rng.uniform(-8, 8, (count, 2)), rng.uniform(0, 5, count)])
    first = unit(np.column_stack([rng.uniform(-0.3, 0.3, (count, 2)), -np.ones(count)]))
    second = unit(first + np.column_stack([rng.uniform(0.05, 0.2, (count, 2)), np.zeros(count)]))
    return point, first, second


def test_two_exact_paths_cross_where_they_were_drawn() -> None:
    point, first, second = bundle(200, np.random.default_rng(0))
    crossing = entry_points(paths_through(point, first, 0.0), paths_through(point, second, 0.0), weighted=False)
    np.testing.assert_allclose(crossing.point_mm, point, atol=1e-9)
    np.testing.assert_allclose(crossing.gap_mm, 0, atol=1e-9)
    np.testing.assert_allclose(np.cos(crossing.angle_rad), (first * second).sum(1), atol=1e-12)


def test_it_does_not_matter_which_position_is_nearer() -> None:
    point, first, _ = bundle(50, np.random.default_rng(1))
    one = paths_through(point, first, 0.1)
    hits = [point + ((z - point[:, 2]) / first[:, 2])[:, None] * first for z in (20.0, 10.0)]
    sd = np.full((50, 2), 0.1)
    other = light_paths((hits[0][:, :2], hits[1][:, :2]), (sd, sd), (FAR, NEAR), cover_glass=None, n_medium=1.0)
    np.testing.assert_allclose(one.direction, other.direction, atol=1e-12)
    np.testing.assert_allclose(one.direction, first, atol=1e-12)
    np.testing.assert_allclose(one.near_mm, other.near_mm, atol=1e-12)


def test_parallel_paths_have_no_crossing() -> None:
    point, first, _ = bundle(5, np.random.default_rng(2))
    crossing = entry_points(paths_through(point, first, 0.0), paths_through(point, first, 0.0), weighted=False)
    assert np.isnan(crossing.point_mm).all()


@pytest.mark.parametrize("weighted", [False, True])
def test_points_and_gaps_scatter_as_their_covariance_says(weighted: bool) -> None:
    rng = np.random.default_rng(3)
    point, first, second = (np.repeat(a[:1], 20_000, axis=0) for a in bundle(1, rng))
    sd = 0.002
    liquid, air = paths_through(point, first, sd, rng), paths_through(point, second, 2 * sd, rng)
    crossing = entry_points(liquid, air, weighted=weighted)
    error = crossing.point_mm - point
    whitened = np.linalg.solve(np.linalg.cholesky(crossing.covariance), error[:, :, None])[:, :, 0]
    # 20000 draws: an rms of unit normals is known to 0.5 %; four of those, and a little for the linearisation.
    np.testing.assert_allclose(np.sqrt((whitened**2).mean(axis=0)), 1, atol=0.03)
    assert np.sqrt(((crossing.gap_mm / crossing.gap_sd_mm) ** 2).mean()) == pytest.approx(1, abs=0.03)
    angle = np.arccos((first[0] * second[0]).sum())
    assert np.sqrt((((crossing.angle_rad - angle) / crossing.angle_sd_rad) ** 2).mean()) == pytest.approx(1, abs=0.03)


def test_weighting_by_variance_never_scatters_more() -> None:
    rng = np.random.default_rng(4)
    point, first, second = (np.repeat(a[:1], 5000, axis=0) for a in bundle(1, rng))
    liquid, air = paths_through(point, first, 0.001, rng), paths_through(point, second, 0.01, rng)
    spread = {
        weighted: np.linalg.norm(entry_points(liquid, air, weighted=weighted).point_mm - point, axis=1).mean()
        for weighted in (False, True)
    }
    assert spread[True] < spread[False]


@given(st.integers(0, 2**31), st.floats(1.0, 1.8), st.floats(1.0, 1.8), st.floats(1.3, 2.0))
def test_both_formulas_return_the_normal_that_bent_the_light(
    seed: int, n_liquid: float, n_air: float, n_object: float
) -> None:
    if abs(n_liquid - n_air) < 0.05:
        n_liquid = n_air + 0.05
    rng = np.random.default_rng(seed)
    normal = unit(
        np.column_stack([rng.uniform(-0.4, 0.4, (20, 2)), np.ones(20)])
    )  # into the liquid, towards the display
    inside = unit(np.column_stack([rng.uniform(-0.3, 0.3, (20, 2)), -np.ones(20)]))
    # Light runs display → object; reversed, it leaves the object along −inside into either medium.
    into_liquid = (
        refract(-inside, normal, n_object, n_liquid) if _refracts(inside, normal, n_object, n_liquid) else None
    )
    into_air = refract(-inside, normal, n_object, n_air) if _refracts(inside, normal, n_object, n_air) else None
    if into_liquid is None or into_air is None:
        return
    by_paths = normals_from_paths(-into_liquid, -into_air, n_liquid=n_liquid, n_air=n_air)
    by_angles = normals_from_angles(-into_liquid, -into_air, n_liquid=n_liquid, n_air=n_air)
    np.testing.assert_allclose(by_paths, normal, atol=1e-7)
    np.testing.assert_allclose(by_angles, normal, atol=1e-6)


def _refracts(inside: np.ndarray, normal: np.ndarray, n_object: float, n_out: float) -> bool:
    cosine = np.abs((inside * normal).sum(1))
    return bool((n_object / n_out * np.sqrt(1 - cosine**2) < 0.999).all())


def test_cover_glass_lifts_a_display_pixel_by_its_apparent_depth() -> None:
    """Paraxially a pixel under glass of thickness t and index n_g appears t·n/n_g below the glass, seen from medium n."""
    glass = CoverGlass(thickness_mm=1.5, n=1.5)
    tilt = 1e-4
    hit = np.array([[0.0, 0.0]])
    far_hit = hit + 10.0 * tilt
    sd = np.zeros((1, 2))
    for n_medium in (1.0, 1.33):
        paths = light_paths((hit, far_hit), (sd, sd), (NEAR, FAR), cover_glass=glass, n_medium=n_medium)
        # Where the path, extended straight back, passes under the pixel: the pixel's image.
        along = (0.0 - paths.near_mm[0, 0]) / paths.direction[0, 0]
        image_z = paths.near_mm[0, 2] + along * paths.direction[0, 2]
        face_z = 10.0 - 1.5
        assert image_z - face_z == pytest.approx(1.5 * n_medium / 1.5, rel=1e-6)


def test_cover_glass_is_exact_for_oblique_light() -> None:
    glass = CoverGlass(thickness_mm=1.5, n=1.52)
    angle_glass = np.radians(25.0)
    angle_water = np.arcsin(1.52 / 1.33 * np.sin(angle_glass))
    hit = np.array([[0.0, 0.0]])
    far_hit = np.array([[10.0 * np.tan(angle_water), 0.0]])
    sd = np.zeros((1, 2))
    paths = light_paths((hit, far_hit), (sd, sd), (NEAR, FAR), cover_glass=glass, n_medium=1.33)
    expected_x = -1.5 * np.tan(angle_glass)
    np.testing.assert_allclose(paths.near_mm[0], [expected_x, 0.0, 8.5], atol=1e-12)
