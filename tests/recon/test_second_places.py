"""Pixels that see two places at once in the liquid: their points err as much as they say, whichever place the centre looks at."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ray_field import exact_places, noisy_sweeps, scene_manifest

from recon.geometry.light_paths import LightPaths, ScreenNoise
from recon.maps import Maps
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.surface.second_places import SecondPlaces
from sim_backend.light_paths import pixel_centre_paths
from sim_backend.scene import load_scene

PIXELS = 4000
SD_MM = 0.01
# In display pixels, along x and in both positions: the other path is parallel to the first.
SHIFT_PX = 9.0
# Few and far apart, so that they are no spot.
STRIDE_PX = 7


def paths_through(point_mm: np.ndarray, direction: np.ndarray) -> LightPaths:
    """Return straight paths through these points, 60 mm before them."""
    count = len(point_mm)
    noise = ScreenNoise(np.full((count, 2), 1e-3), np.eye(3)[:, :2])
    return LightPaths(point_mm - 60.0 * direction, direction, np.full(count, 40.0), noise, noise)


def directions(rng: np.random.Generator) -> np.ndarray:
    """Return unit vectors about the z axis."""
    tilted = np.array([0.0, 0.0, 1.0]) + 0.3 * rng.standard_normal((PIXELS, 3))
    return tilted / np.linalg.norm(tilted, axis=1, keepdims=True)


def maps_at(point_mm: np.ndarray, status: PixelStatus) -> Maps:
    sd = np.full((1, PIXELS), SD_MM, np.float32)
    return Maps(
        point_mm=point_mm[None],
        normal=np.broadcast_to([0.0, 0.0, -1.0], (1, PIXELS, 3)),
        sd_mm=sd,
        gap_mm=sd,
        pbc_angle_rad=sd,
        status=np.full((1, PIXELS), status, np.uint8),
    )


@pytest.mark.parametrize("first", [0, 1], ids=["by the path with more light", "by the path with less"])
def test_a_point_errs_as_it_says_where_the_centre_looks_at_either_place(first: int) -> None:
    rng = np.random.default_rng(1)
    point_mm, along, other = rng.uniform(-20, 20, (PIXELS, 3)), directions(rng), directions(rng)
    # The other place lies 2.3 mm beside the point, at right angles to the path that leads there.
    aside = np.cross(other, rng.standard_normal((PIXELS, 3)))
    elsewhere = point_mm + 2.3 * aside / np.linalg.norm(aside, axis=1, keepdims=True)
    true_mm = np.where(rng.random((PIXELS, 1)) < 0.5, point_mm, elsewhere)
    found_mm = point_mm + SD_MM / np.sqrt(3) * rng.standard_normal(point_mm.shape)
    both = paths_through(point_mm, along), paths_through(elsewhere, other)
    second = SecondPlaces(np.arange(PIXELS), both if first == 0 else (both[1], both[0]))
    maps = second.widened(maps_at(found_mm, PixelStatus.OK))
    ratio = np.linalg.norm(found_mm - true_mm, axis=1) / maps.sd_mm[0]
    # Half of the squares are 2 and the others 0: their mean has an sd of 1/sqrt(4000); four of them.
    assert (ratio**2).mean() == pytest.approx(1.0, abs=4 / np.sqrt(PIXELS))


def test_two_paths_that_leave_one_place_take_no_certainty_from_it() -> None:
    rng = np.random.default_rng(2)
    point_mm = rng.uniform(-20, 20, (PIXELS, 3))
    # At a crease both faces bend light their own way, from the same place.
    crease = paths_through(point_mm, directions(rng)), paths_through(point_mm, directions(rng))
    maps = SecondPlaces(np.arange(PIXELS), crease).widened(maps_at(point_mm, PixelStatus.OK))
    np.testing.assert_allclose(maps.sd_mm, SD_MM, rtol=1e-5)


def test_what_the_surface_about_a_pixel_says_of_it_is_left_as_it_is() -> None:
    rng = np.random.default_rng(3)
    point_mm = rng.uniform(-20, 20, (PIXELS, 3))
    apart = paths_through(point_mm, directions(rng)), paths_through(point_mm + 5.0, directions(rng))
    maps = SecondPlaces(np.arange(PIXELS), apart).widened(maps_at(point_mm, PixelStatus.COVERED))
    np.testing.assert_allclose(maps.sd_mm, SD_MM, rtol=1e-5)


def test_a_second_path_beside_the_first_tells_in_the_maps_how_far_beside() -> None:
    scene = load_scene("hemisphere").resized(camera_columns=48)
    sweeps = noisy_sweeps(exact_places(scene), sd_px=0.05, rng=np.random.default_rng(4))
    session = Session(Path("no photos"), scene_manifest(scene), {})
    settings = Settings(registration=False, threads=1)
    alone = reconstruct(session, sweeps, settings).maps
    here = np.zeros(alone.status.shape, bool)
    here[::STRIDE_PX, ::STRIDE_PX] = True
    for position in ("pos0", "pos1"):
        for axis, shift_px in (("x", SHIFT_PX), ("y", 0.0)):
            sweep = sweeps[f"{position}_liquid", axis]
            two = here & (sweep.status == PixelStatus.OK)
            sweeps[f"{position}_liquid", axis] = replace(
                sweep,
                status=np.where(two, PixelStatus.TWO_PATHS, sweep.status).astype(np.uint8),
                second_px=(sweep.place_px + shift_px)[two],
                second_sd_px=sweep.sd_px[two],
            )
    maps = reconstruct(session, sweeps, settings).maps
    two = here & (maps.status == PixelStatus.OK) & (alone.status == PixelStatus.OK)
    assert two.sum() > 10
    shift_mm = SHIFT_PX * session.manifest.display.pitch_mm
    along_x = pixel_centre_paths(scene, scene.world(wet=True)).direction.reshape(*two.shape, 3)[..., 0]
    # The point itself is off its path by up to some percent of that.
    beside_mm = shift_mm * np.sqrt(1 - along_x**2)
    expected_mm = np.sqrt(alone.sd_mm**2 + beside_mm**2 / 2)
    np.testing.assert_allclose(maps.sd_mm[two], expected_mm[two], rtol=0.05)
    others = ~here & (alone.status == PixelStatus.OK)
    np.testing.assert_allclose(maps.sd_mm[others], alone.sd_mm[others], rtol=1e-6)
