"""The path from the camera to the panel, against the simulator's optics, which share no code with it."""

import numpy as np
import pytest
from seen_corners import lab_scene, seen_places, true_lens, true_pose

from recon.calibration.lens import view_rays
from recon.calibration.sight_line import LiquidPlane, bent, panel_places

GRID_MM = np.stack(np.meshgrid(np.linspace(-95, 95, 9), np.linspace(-70, 70, 7)), axis=-1).reshape(-1, 2)
ROUNDING_MM = 1e-8


@pytest.mark.parametrize("wet", [False, True])
@pytest.mark.parametrize("glass_mm", [None, 1.5])
def test_the_simulators_path_to_the_panel_is_followed_exactly(wet: bool, glass_mm: float | None) -> None:
    scene = lab_scene(glass_mm=glass_mm)
    stage_mm = scene.stage_positions_mm[1]
    place_px = seen_places(scene, GRID_MM, stage_mm, wet=wet)
    down = scene.camera.world_from_camera().T @ np.array([0.0, 0.0, 1.0])
    assert scene.liquid_level_mm is not None
    assert scene.n_liquid is not None
    level = LiquidPlane(down, scene.liquid_level_mm - scene.camera.position_mm[2])
    found = panel_places(
        view_rays(place_px, true_lens(scene)),
        true_pose(scene, stage_mm),
        n_air=scene.n_air,
        liquid=level if wet else None,
        n_liquid=scene.n_liquid,
        glass_mm=glass_mm or 0.0,
        n_glass=1.52,
    )
    assert np.abs(found - GRID_MM).max() < ROUNDING_MM


def test_light_bends_by_snells_law() -> None:
    incidence = np.radians(np.array([0.0, 10.0, 35.0, 80.0]))
    rays = np.column_stack([np.sin(incidence), np.zeros(4), np.cos(incidence)])
    after = bent(rays, np.array([0.0, 0.0, 1.0]), n_from=1.0, n_to=1.3355)
    assert np.allclose(1.3355 * after[:, 0], np.sin(incidence), atol=1e-14)
    assert np.allclose(np.linalg.norm(after, axis=1), 1.0, atol=1e-14)


def test_beyond_the_critical_angle_there_is_no_path() -> None:
    ray = np.array([[np.sin(1.0), 0.0, np.cos(1.0)]])
    assert np.isnan(bent(ray, np.array([0.0, 0.0, 1.0]), n_from=1.5, n_to=1.0)).all()


def test_a_ray_that_runs_away_from_the_panel_ends_nowhere() -> None:
    scene = lab_scene()
    back = np.array([[0.0, 0.0, -1.0]])
    assert np.isnan(panel_places(back, true_pose(scene, 53.0), n_air=1.0)).all()
