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
PITCH_MM = 0.05
SHAPE = (ROWS * 4, COLS * 4)
POSES = tuple(Pose(centre_mm=(0.0, 0.0, z), x_axis=(1.0, 0.0, 0.0), y_axis=(0.0, 1.0, 0.0)) for z in (10.0, 20.0))


def scene(*, camera: bool = True) -> Manifest:
    fields = manifest()
    fields["liquid"]["n"] = N_WATER
    fields["display"]["pitch_mm"] = PITCH_MM
    pose = {"centre_mm": [0.0, 0.0, CAMERA_Z], "x_axis": [1.0, 0.0, 0.0], "y_axis": [0.0, 1.0, 0.0]}
    fields["camera"] = {"columns": SHAPE[1], "rows": SHAPE[0], **({"pose": pose} if camera else {})}
    return Manifest.model_validate(fields)


def paths(
    point: np.ndarray, direction: np.ndarray, rng: np.random.Generator, sd_mm: float, drawn_mm: np.ndarray | float = 0.0
) -> LightPaths:
    """Return the paths through ``point`` whose light travels towards −z along ``direction``, measured with noise.

    Places at the nearer display are ``drawn_mm`` too far along x, those at the farther one as much too near.
    """
    hits = [
        (point + ((z - point[:, 2]) / direction[:, 2])[:, None] * direction)[:, :2]
        + rng.normal(0, sd_mm, (len(point), 2))
        + np.column_stack([np.broadcast_to(sign * drawn_mm, len(point)), np.zeros(len(point))])
        for z, sign in ((10.0, 1), (20.0, -1))
    ]
    sd = np.full((len(point), 2), sd_mm)
    return light_paths((hits[0], hits[1]), (sd, sd), POSES, cover_glass=None, n_medium=1.0)


def wet(out: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return where light that leaves towards ``out`` in air goes in liquid: Snell keeps n times the part along the surface."""
    upright = (out @ normal)[:, None] * normal
    along = (out - upright) / N_WATER
    return along + np.sqrt(1 - (along**2).sum(axis=1, keepdims=True)) * normal


def marked(
    *, tilt: float, sd_mm: float, camera: bool = True, slope: float = 0.0, depth_mm: float = 0.0
) -> tuple[float, float]:
    """Return the marked share on the left half, which looks past the object, and on the right half.

    There light is bent by ``tilt`` in air and leaves a plane ``depth_mm`` below the level that rises with x by ``slope``.
    """
    rng = np.random.default_rng(0)
    rows, cols = np.indices(SHAPE)
    x, y = (cols.ravel() - SHAPE[1] / 2) * 0.3, (rows.ravel() - SHAPE[0] / 2) * 0.3
    right = x > 0
    point = np.column_stack([x, y, np.where(right, LEVEL_Z + depth_mm + slope * x, LEVEL_Z)])
    out = np.column_stack([x, y, np.full(x.size, LEVEL_Z - CAMERA_Z)])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    out[right, 0] += tilt
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    facet = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    inside = np.where(right[:, None], wet(out, facet), wet(out, np.array([0.0, 0.0, 1.0])))
    air, liquid = paths(point, -out, rng, sd_mm), paths(point, -inside, rng, sd_mm)
    points = entry_points(liquid, air, weighted=True)
    found = liquid_surface(
        points,
        liquid,
        air,
        normals_from_paths(liquid.direction, air.direction, n_liquid=N_WATER, n_air=1.0),
        scene(camera=camera),
        direction_sd_rad=np.sqrt(np.trace(air.direction_covariance(), axis1=1, axis2=2)),
        pixels=np.arange(x.size),
        shape=SHAPE,
    )
    # A neighbourhood that reaches across the middle belongs to neither half.
    clear = np.abs(x) > 4 * 0.3
    return float(found[clear & (x < 0)].mean()), float(found[clear & (x > 0)].mean())


@pytest.mark.parametrize("sd_mm", [1e-5, 1e-3])
def test_unbent_paths_at_the_level_are_marked_and_a_facet_below_it_is_not(sd_mm: float) -> None:
    past, facet = marked(tilt=0.05, sd_mm=sd_mm, slope=0.2, depth_mm=1.0)
    assert past > 0.95
    assert facet < 0.01


def test_light_bent_before_it_meets_the_level_is_marked_too() -> None:
    past, above = marked(tilt=0.2, sd_mm=1e-3)
    assert past > 0.95
    assert above > 0.95


def test_a_level_face_of_the_object_just_below_the_liquid_is_not_taken_for_it() -> None:
    # Two standard deviations deep: the depth of these crossings is known to 0.037 mm at the median.
    _, face = marked(tilt=0.2, sd_mm=1e-3, depth_mm=0.075)
    assert face < 0.01


def marked_at_outline(drawn_mm: float) -> float:
    """Return the marked share of the last column that looks past an object whose light draws that column's places."""
    rng = np.random.default_rng(4)
    rows, cols = np.indices(SHAPE)
    x, y = (cols.ravel() - SHAPE[1] / 2) * 0.3, (rows.ravel() - SHAPE[0] / 2) * 0.3
    past = x <= 0
    point = np.column_stack([x, y, np.full(x.size, LEVEL_Z)])[past]
    out = point - [0.0, 0.0, CAMERA_Z]
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    last = (x == 0)[past]
    drawn = np.where(last, drawn_mm, 0.0)
    liquid = paths(point, -wet(out, np.array([0.0, 0.0, 1.0])), rng, 1e-4, -drawn)
    air = paths(point, -out, rng, 1e-4, drawn)
    found = liquid_surface(
        entry_points(liquid, air, weighted=True),
        liquid,
        air,
        normals_from_paths(liquid.direction, air.direction, n_liquid=N_WATER, n_air=1.0),
        scene(),
        direction_sd_rad=np.full(len(point), 1e-5),
        pixels=np.flatnonzero(past),
        shape=SHAPE,
    )
    return float(found[last].mean())


def test_a_pixel_of_the_level_whose_places_the_object_draws_by_less_than_half_a_device_pixel_is_still_marked() -> None:
    assert marked_at_outline(0.4 * PITCH_MM) > 0.95
    assert marked_at_outline(1.0 * PITCH_MM) < 0.05


def test_nothing_is_marked_where_the_camera_is_not_known() -> None:
    assert marked(tilt=0.05, sd_mm=1e-4, camera=False) == (0.0, 0.0)


def test_nothing_is_marked_where_every_path_is_bent() -> None:
    rng = np.random.default_rng(1)
    point = np.column_stack([rng.uniform(-5, 5, (400, 2)), np.full(400, LEVEL_Z)])
    out = np.column_stack([rng.uniform(0.1, 0.2, (400, 2)), np.ones(400)])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    air = paths(point, -out, rng, 1e-4)
    found = liquid_surface(
        entry_points(air, air, weighted=True),
        air,
        air,
        np.tile([0.0, 0.0, 1.0], (400, 1)),
        scene(),
        direction_sd_rad=np.full(400, 1e-5),
        pixels=np.arange(400),
        shape=SHAPE,
    )
    assert not found.any()
