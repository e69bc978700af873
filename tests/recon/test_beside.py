"""Pixels that look past the object at the liquid's flat surface, built here from Snell's law alone."""

import numpy as np
import pytest
from session_example import COLS, ROWS, manifest

from recon.geometry.beside import liquid_surface
from recon.geometry.entry_point import entry_points
from recon.geometry.light_paths import LightPaths, light_paths
from recon.geometry.normals import normals_from_paths
from recon.sessions.manifest import Manifest, Pose

N_WATER = 1.333
CAMERA_Z, LEVEL_Z = -60.0, 2.0
SHAPE = (ROWS * 4, COLS * 4)
POSES = tuple(Pose(centre_mm=(0.0, 0.0, z), x_axis=(1.0, 0.0, 0.0), y_axis=(0.0, 1.0, 0.0)) for z in (10.0, 20.0))


def scene(*, camera: bool = True) -> Manifest:
    fields = manifest()
    fields["liquid"]["n"] = N_WATER
    pose = {"centre_mm": [0.0, 0.0, CAMERA_Z], "x_axis": [1.0, 0.0, 0.0], "y_axis": [0.0, 1.0, 0.0]}
    fields["camera"] = {"columns": SHAPE[1], "rows": SHAPE[0], **({"pose": pose} if camera else {})}
    return Manifest.model_validate(fields)


def paths(point: np.ndarray, direction: np.ndarray, rng: np.random.Generator, sd_mm: float) -> LightPaths:
    """Return the paths through ``point`` whose light travels towards −z along ``direction``, measured with noise."""
    hits = [
        (point + ((z - point[:, 2]) / direction[:, 2])[:, None] * direction)[:, :2]
        + rng.normal(0, sd_mm, (len(point), 2))
        for z in (10.0, 20.0)
    ]
    sd = np.full((len(point), 2), sd_mm)
    return light_paths((hits[0], hits[1]), (sd, sd), POSES, cover_glass=None, n_medium=1.0)


def marked(*, tilt: float, sd_mm: float, camera: bool = True) -> np.ndarray:
    """Return the marked share on the left half (past the object) and right half (bent by ``tilt`` in air)."""
    rng = np.random.default_rng(0)
    rows, cols = np.indices(SHAPE)
    x, y = (cols.ravel() - SHAPE[1] / 2) * 0.3, (rows.ravel() - SHAPE[0] / 2) * 0.3
    point = np.column_stack([x, y, np.full(x.size, LEVEL_Z)])
    out = point - [0.0, 0.0, CAMERA_Z]
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    out[x > 0, 0] += tilt
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    sideways = out[:, :2] / N_WATER  # Snell at a level surface
    wet = np.column_stack([sideways, np.sqrt(1 - (sideways**2).sum(1))])
    air, liquid = paths(point, -out, rng, sd_mm), paths(point, -wet, rng, sd_mm)
    points = entry_points(liquid, air, weighted=True)
    found = liquid_surface(
        points,
        air,
        normals_from_paths(liquid.direction, air.direction, n_liquid=N_WATER, n_air=1.0),
        scene(camera=camera),
        direction_sd_rad=np.sqrt(np.trace(air.direction_covariance(), axis1=1, axis2=2)),
        pixels=np.arange(x.size),
        shape=SHAPE,
    )
    # A neighbourhood that reaches across the middle belongs to neither half.
    clear = np.abs(x) > 4 * 0.3
    return np.array([found[clear & (x < 0)].mean(), found[clear & (x > 0)].mean()])


@pytest.mark.parametrize("sd_mm", [1e-5, 1e-3])
def test_unbent_paths_at_the_level_are_marked_and_bent_ones_are_not(sd_mm: float) -> None:
    past, bent = marked(tilt=0.05, sd_mm=sd_mm)
    assert past > 0.95
    assert bent < 0.01


def test_nothing_is_marked_where_the_camera_is_not_known() -> None:
    assert not marked(tilt=0.05, sd_mm=1e-4, camera=False).any()


def test_nothing_is_marked_where_every_path_is_bent() -> None:
    rng = np.random.default_rng(1)
    point = np.column_stack([rng.uniform(-5, 5, (400, 2)), np.full(400, LEVEL_Z)])
    out = np.column_stack([rng.uniform(0.1, 0.2, (400, 2)), np.ones(400)])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    air = paths(point, -out, rng, 1e-4)
    found = liquid_surface(
        entry_points(air, air, weighted=True),
        air,
        np.tile([0.0, 0.0, 1.0], (400, 1)),
        scene(),
        direction_sd_rad=np.full(400, 1e-5),
        pixels=np.arange(400),
        shape=SHAPE,
    )
    assert not found.any()
