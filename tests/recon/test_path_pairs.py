"""Which light paths of a pixel that sees the display twice belong together: those that meet."""

from dataclasses import replace

import numpy as np
import pytest
from ray_field import crossed, exact_places, noisy_sweeps, scene_manifest

from recon.maps import Maps
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from sim_backend.scene import load_scene

ASTRAY_PX = 40.0
Sweeps = dict[tuple[str, str], SweepResult]


@pytest.fixture(scope="module")
def hemisphere() -> tuple[Sweeps, Manifest]:
    scene = load_scene("hemisphere").resized(camera_columns=32)
    sweeps = noisy_sweeps(exact_places(scene), sd_px=0.05, rng=np.random.default_rng(4))
    return sweeps, scene_manifest(scene)


def seen_twice(sweeps: Sweeps, *, astray_first: tuple[str, ...], astray_second: tuple[str, ...]) -> Sweeps:
    """Return sweeps whose lit pixels all saw a second path in air, each path of them astray in the positions that are named."""
    result = dict(sweeps)
    for position, sign in (("pos0", 1.0), ("pos1", -1.0)):
        for axis in ("x", "y"):
            sweep = sweeps[f"{position}_air", axis]
            lit = sweep.status == PixelStatus.OK
            away = sweep.place_px + sign * ASTRAY_PX
            result[f"{position}_air", axis] = replace(
                sweep,
                place_px=away if position in astray_first else sweep.place_px,
                second_px=(away if position in astray_second else sweep.place_px)[lit],
                second_sd_px=sweep.sd_px[lit],
                status=np.where(lit, PixelStatus.TWO_PATHS, sweep.status).astype(np.uint8),
            )
    return result


def share_with_point(maps: Maps, whole: Maps) -> float:
    return float((maps.valid() & whole.valid()).sum() / whole.valid().sum())


def test_the_paths_with_more_light_are_taken_where_they_meet(hemisphere: tuple[Sweeps, Manifest]) -> None:
    sweeps, manifest = hemisphere
    whole, _ = crossed(sweeps, manifest, "full")
    maps, _ = crossed(seen_twice(sweeps, astray_first=(), astray_second=("pos0", "pos1")), manifest, "full")
    assert share_with_point(maps, whole) == 1.0
    np.testing.assert_array_equal(maps.point_mm, whole.point_mm)


def test_the_other_path_is_taken_where_only_that_one_meets(hemisphere: tuple[Sweeps, Manifest]) -> None:
    sweeps, manifest = hemisphere
    whole, _ = crossed(sweeps, manifest, "full")
    maps, _ = crossed(seen_twice(sweeps, astray_first=("pos0", "pos1"), astray_second=()), manifest, "full")
    # Some false paths lie in the plane of the true ones, and meet by chance.
    assert share_with_point(maps, whole) > 0.9
    same = maps.valid() & whole.valid()
    error_mm = np.linalg.norm(maps.point_mm - whole.point_mm, axis=2)[same]
    assert (error_mm < 1e-9).mean() > 0.9


def test_no_point_is_made_of_paths_that_do_not_meet(hemisphere: tuple[Sweeps, Manifest]) -> None:
    sweeps, manifest = hemisphere
    whole, _ = crossed(sweeps, manifest, "full")
    maps, _ = crossed(seen_twice(sweeps, astray_first=("pos0",), astray_second=("pos1",)), manifest, "full")
    assert (maps.status[whole.valid()] == PixelStatus.TWO_PATHS).mean() > 0.9
