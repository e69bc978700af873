"""Pixels without a measurement, covered from the surface about them: spheres, a step and a roof in closed form."""

import numpy as np
import pytest

from recon.geometry.light_paths import LightPaths, ScreenNoise
from recon.maps import Maps, Support
from recon.status import PixelStatus
from recon.surface import window_guesses
from recon.surface.covering import with_covered
from recon.surface.own_paths import OwnPaths
from recon.surface.strays import without_strays

SHAPE = (41, 41)
SPACING_MM, SD_MM, SD_RAD = 0.2, 0.004, 2e-3
RADIUS_MM = 28.0
NOTHING = np.zeros(SHAPE, bool)
ROW, COL = (np.float64(each) for each in np.indices(SHAPE))
X, Y = SPACING_MM * (COL - 20), SPACING_MM * (ROW - 20)


def maps_of(z_mm: np.ndarray, slope_x: np.ndarray, slope_y: np.ndarray, missing: np.ndarray) -> Maps:
    """Return a surface z(x, y) seen along z, with noise, and nothing at the missing pixels."""
    rng = np.random.default_rng(3)
    point = np.stack([X, Y, z_mm], axis=2)
    normal = np.stack([-slope_x, -slope_y, np.ones(SHAPE)], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    point = point + SD_MM / np.sqrt(3) * rng.standard_normal(point.shape)
    point[missing] = normal[missing] = np.nan

    def everywhere(value: float) -> np.ndarray:
        return np.where(missing, np.nan, value).astype(np.float32)

    return Maps(
        point_mm=point,
        normal=normal,
        sd_mm=everywhere(SD_MM),
        gap_mm=everywhere(0.0),
        pbc_angle_rad=everywhere(0.2),
        status=np.where(missing, np.uint8(PixelStatus.BAD_FIT), np.uint8(PixelStatus.OK)),
        normal_sd_rad=everywhere(SD_RAD),
        across_sd_mm=everywhere(SD_MM / np.sqrt(3)),
        support=np.where(missing, np.uint8(Support.NONE), np.uint8(Support.OWN_CROSSING)),
    )


def sphere(missing: np.ndarray) -> Maps:
    depth = np.sqrt(RADIUS_MM**2 - X**2 - Y**2)
    return maps_of(depth, -X / depth, -Y / depth, missing)


def paths_of(pixels: np.ndarray, *, aside_mm: float = 0.0) -> OwnPaths:
    """Return paths along z through these pixels' true places in the liquid, or beside them, and none in air."""
    number = np.flatnonzero(pixels)
    near = np.stack([X.ravel()[number] + aside_mm, Y.ravel()[number], np.zeros(len(number))], axis=1)
    along = np.tile([0.0, 0.0, 1.0], (len(number), 1))
    noise = ScreenNoise(np.full((len(number), 2), 1e-3), np.eye(3)[:, :2])
    path = LightPaths(near, along, np.full(len(number), 40.0), noise, noise)
    none = path.some(slice(0, 0))
    return OwnPaths({"liquid": number, "air": number[:0]}, {"liquid": path, "air": none})


def test_a_hole_in_a_sphere_is_covered_by_points_as_far_off_as_they_say() -> None:
    hole = np.hypot(ROW - 18, COL - 22) < 4.5
    maps = with_covered(sphere(hole), paths_of(NOTHING))
    assert (maps.status[hole] == PixelStatus.COVERED).all()
    assert not maps.valid()[hole].any()
    assert maps.support is not None
    assert (maps.support[hole] == Support.COVERED).all()
    true_mm = np.stack([X, Y, np.sqrt(RADIUS_MM**2 - X**2 - Y**2)], axis=2)[hole]
    error_mm = np.linalg.norm(maps.point_mm[hole] - true_mm, axis=1)
    # Independent noise is averaged; the sd allows for neighbours whose errors are alike.
    assert (error_mm < 3 * maps.sd_mm[hole]).all()
    assert (maps.sd_mm[hole] > SD_MM).all()
    cosine = (maps.normal[hole] * true_mm).sum(axis=1) / RADIUS_MM
    assert np.degrees(np.arccos(np.minimum(cosine, 1.0))).max() < 0.1


def test_nothing_is_covered_on_a_step() -> None:
    missing = COL == 20
    maps = with_covered(maps_of(np.where(COL < 20, 0.0, 0.5), 0 * X, 0 * X, missing), paths_of(NOTHING))
    assert not (maps.status == PixelStatus.COVERED).any()


def test_at_a_crease_a_pixel_is_covered_by_the_side_it_looks_at() -> None:
    ridge_mm, slope = 0.06, 0.4
    # The ridge passes between the middle of the missing pixels and their right edge: they look at the left side.
    side = np.sign(X - ridge_mm)
    missing = (COL == 20) & (np.abs(ROW - 20) < 15)
    maps = with_covered(maps_of(-slope * np.abs(X - ridge_mm), -slope * side, 0 * X, missing), paths_of(NOTHING))
    assert (maps.status[missing] == PixelStatus.COVERED).all()
    np.testing.assert_allclose(maps.normal[missing][:, 0], -slope / np.hypot(1, slope), atol=0.01)
    np.testing.assert_allclose(maps.point_mm[missing][:, 2], -slope * ridge_mm, atol=0.02)


@pytest.mark.parametrize(
    ("own", "covered"), [(0.0, True), (0.05, False), (None, False)], ids=["passes", "passes beside", "none"]
)
def test_beyond_the_last_point_only_a_path_in_liquid_that_goes_there_carries_the_surface_on(
    own: float | None, covered: bool
) -> None:
    beyond = np.hypot(ROW - 20, COL - 20) > 15
    paths = paths_of(NOTHING) if own is None else paths_of(beyond, aside_mm=own)
    maps = with_covered(sphere(beyond), paths)
    found = maps.status == PixelStatus.COVERED
    assert found.any() == covered
    # A pixel and no more.
    assert not found[np.hypot(ROW - 20, COL - 20) > 15 + np.sqrt(2)].any()


def test_a_hole_whose_own_two_paths_go_elsewhere_stays_open() -> None:
    hole = np.hypot(ROW - 18, COL - 22) < 2.5
    aside = paths_of(hole, aside_mm=0.1)
    both = OwnPaths(
        {"liquid": aside.pixels["liquid"], "air": aside.pixels["liquid"]},
        {"liquid": aside.paths["liquid"], "air": aside.paths["liquid"]},
    )
    assert (with_covered(sphere(hole), both).status[hole] == PixelStatus.BAD_FIT).all()
    assert (with_covered(sphere(hole), aside).status[hole] == PixelStatus.COVERED).all()


def test_a_point_at_the_rim_that_the_points_within_contradict_is_taken_out_and_no_other() -> None:
    beyond = np.hypot(ROW - 20, COL - 20) > 15
    sound = sphere(beyond)
    assert (without_strays(sound).status == sound.status).all()
    # A pixel at the rim slid along the surface, as one does whose code is a period off: no gap shows it.
    row, col = 20, 5
    sound.point_mm[row, col, 0] += 10 * SD_MM
    found = without_strays(sound).status != sound.status
    assert np.argwhere(found).tolist() == [[row, col]]


@pytest.mark.parametrize(
    ("off_mm", "pixels", "out"),
    [(10.0, 1, True), (0.5, 1, False), (10.0, 3, False)],
    ids=["far off", "within what the surface is known to", "a strip of another surface"],
)
def test_a_surface_too_unsure_to_cover_a_pixel_still_contradicts_a_lone_point_far_from_it(
    off_mm: float, pixels: int, out: bool
) -> None:
    beyond = np.hypot(ROW - 20, COL - 20) > 15
    maps = sphere(beyond)
    # Less sure than neighbours are apart: nothing is covered by such points.
    maps.sd_mm[~beyond] = 1.25 * SPACING_MM
    strip = (slice(19, 19 + pixels), 6)
    maps.sd_mm[strip] = SD_MM
    maps.point_mm[(*strip, 2)] += off_mm
    found = without_strays(maps).status != maps.status
    assert found[strip].all() == out
    assert found.sum() == (pixels if out else 0)


def test_threads_change_nothing_of_what_is_taken_out_and_covered(monkeypatch: pytest.MonkeyPatch) -> None:
    # So few pixels a part that the threads share them.
    monkeypatch.setattr(window_guesses, "PIXELS_AT_ONCE", 4)
    hole = (ROW - 20) ** 2 + (COL - 20) ** 2 < 9
    alone, shared = (
        with_covered(without_strays(sphere(hole), threads=threads), paths_of(NOTHING), threads=threads)
        for threads in (1, 2)
    )
    assert (alone.status == PixelStatus.COVERED).any()
    assert np.array_equal(alone.status, shared.status)
    assert np.array_equal(alone.point_mm, shared.point_mm, equal_nan=True)
