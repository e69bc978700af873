"""What a slip costs, against the crossing of two paths of which one was moved."""

import numpy as np
import pytest

from recon.geometry.entry_point import entry_points
from recon.geometry.light_paths import light_paths
from recon.scene.scene_error import display_lever, fep_error_mm, photo_scale_mm, places_along_paths, typical_angle_rad
from recon.sessions.manifest import CameraBody, Intrinsics, Pose

POSES = (
    Pose(centre_mm=(0, 0, 25), x_axis=(1, 0, 0), y_axis=(0, 1, 0)),
    Pose(centre_mm=(0, 0, 65), x_axis=(1, 0, 0), y_axis=(0, 1, 0)),
)


def crossing(liquid: tuple[np.ndarray, np.ndarray], air: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    nothing = np.full((1, 2), 1e-3)
    paths = [
        light_paths((near[None, :2], far[None, :2]), (nothing, nothing), POSES, cover_glass=None, n_medium=1.0)
        for near, far in (liquid, air)
    ]
    return entry_points(*paths, weighted=False).point_mm[0]


def path(direction: np.ndarray, slip_mm: float = 0.0, *, position: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Where a path through the origin meets both displays, one of which slipped along x."""
    points = [np.array([direction[0] / direction[2] * z, direction[1] / direction[2] * z, z]) for z in (25.0, 65.0)]
    points[position][0] += slip_mm
    return points[0], points[1]


@pytest.mark.parametrize("position", [0, 1])
def test_a_slip_moves_the_crossing_along_the_other_path_by_its_lever_over_the_angle(position: int) -> None:
    steep, flat = np.radians(20.0), np.radians(31.0)
    liquid, air = np.array([np.sin(steep), 0, np.cos(steep)]), np.array([np.sin(flat), 0, np.cos(flat)])
    slip_mm = 1e-3
    error_mm = np.linalg.norm(crossing(path(liquid, slip_mm, position=position), path(air)))
    # The origin lies 25 mm before position 0 on a baseline of 40 mm: a = −0.625. A slip along x is across the path by its
    # cosine, and turns the path, and the angle, only in second order.
    lever = (1 + 0.625) if position == 0 else 0.625
    by_hand_mm = lever * slip_mm * np.cos(steep) / np.sin(flat - steep)
    assert error_mm == pytest.approx(by_hand_mm, rel=1e-3)
    place = places_along_paths(np.zeros((1, 3)), POSES)
    assert place == pytest.approx(-0.625)
    worst_mm = fep_error_mm(slip_mm, lever=float(display_lever(place)[0]), angle_rad=flat - steep)
    assert error_mm <= worst_mm
    if position == 0:
        assert worst_mm == pytest.approx(error_mm / np.cos(steep), rel=1e-3)


def test_the_typical_angle_follows_from_snells_law() -> None:
    # sin 30° · 1.333 = 0.6665, arcsin 41.80°
    assert typical_angle_rad(n_liquid=1.333, n_air=1.0) == pytest.approx(np.radians(11.80), abs=1e-4)


def test_a_photo_pixel_sees_its_distance_over_the_focal_length() -> None:
    camera = CameraBody(
        columns=320,
        rows=320,
        pose=Pose(centre_mm=(0, 0, -420), x_axis=(1, 0, 0), y_axis=(0, 1, 0)),
        intrinsics=Intrinsics(focal_x_px=2100, focal_y_px=2100, centre_x_px=159.5, centre_y_px=159.5),
    )
    assert photo_scale_mm(camera, POSES[0]) == pytest.approx(445 / 2100)
    assert photo_scale_mm(camera.model_copy(update={"pose": None}), POSES[0]) is None
