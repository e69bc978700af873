"""The mesh of a point map: how many triangles, which way they face, and where they stop."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from recon.surface.mesh import Mesh, mesh_from_point_map, vertex_normals


def plane_map(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A flat sheet seen from −z, one unit a pixel; its normal points towards +z."""
    row, col = np.mgrid[:rows, :cols].astype(float)
    point = np.stack([col, row, np.zeros((rows, cols))], axis=2)
    normal = np.broadcast_to([0.0, 0.0, 1.0], point.shape).copy()
    return point, normal, np.ones((rows, cols), bool)


def area(mesh: Mesh) -> float:
    return float(trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).area)


def test_full_grid_gives_two_triangles_for_every_four_pixels() -> None:
    mesh = mesh_from_point_map(*plane_map(5, 7))
    assert len(mesh.vertices_mm) == 35
    assert len(mesh.faces) == 2 * 4 * 6
    assert area(mesh) == pytest.approx(4 * 6)


def test_three_pixels_of_four_give_one_triangle() -> None:
    for row, col in ((0, 0), (0, 1), (1, 0), (1, 1)):
        point, normal, mask = plane_map(2, 2)
        mask[row, col] = False
        mesh = mesh_from_point_map(point, normal, mask)
        assert len(mesh.faces) == 1
        assert area(mesh) == pytest.approx(0.5)


def test_pixels_without_a_finite_point_are_left_out() -> None:
    point, normal, mask = plane_map(3, 3)
    point[1, 1] = np.nan
    mesh = mesh_from_point_map(point, normal, mask)
    assert len(mesh.vertices_mm) == 8
    assert len(mesh.faces) == 4
    assert np.isfinite(mesh.vertices_mm).all()


def test_faces_wind_with_the_normals_given() -> None:
    point, normal, mask = plane_map(4, 4)
    for sign in (1, -1):
        mesh = mesh_from_point_map(point, sign * normal, mask)
        facing = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).face_normals
        assert np.allclose(facing, [0, 0, sign])


def test_missing_normal_is_taken_from_the_faces() -> None:
    point, normal, mask = plane_map(4, 4)
    normal[2, 2] = np.nan
    mesh = mesh_from_point_map(point, normal, mask)
    assert np.allclose(mesh.normal, [0, 0, 1])


def test_shorter_diagonal_is_chosen() -> None:
    point, normal, mask = plane_map(2, 2)
    point[0, 0] += [-1, -1, 0]  # stretches the falling diagonal
    mesh = mesh_from_point_map(point, normal, mask)
    corners = point.reshape(-1, 3)
    shared = [set(map(tuple, mesh.vertices_mm[face])) for face in mesh.faces]
    assert shared[0] & shared[1] == {tuple(corners[1]), tuple(corners[2])}


def test_step_of_depth_is_not_bridged() -> None:
    point, normal, mask = plane_map(20, 20)
    point[:, 10:, 2] += 50
    mesh = mesh_from_point_map(point, normal, mask)
    assert trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).body_count == 2
    assert area(mesh) == pytest.approx(2 * 19 * 9)


def test_sphere_seen_head_on_is_meshed_up_to_its_rim() -> None:
    row, col = np.mgrid[-30:31, -30:31].astype(float)
    inside = row**2 + col**2 < 30**2
    height = np.sqrt(np.where(inside, 30**2 - row**2 - col**2, np.nan))
    point = np.stack([col, row, height], axis=2)
    mesh = mesh_from_point_map(point, point / 30, inside)
    assert len(mesh.vertices_mm) == inside.sum()


@settings(max_examples=20, deadline=None)
@given(scale=st.floats(1e-3, 1e3), seed=st.integers(0, 1000))
def test_scaling_the_scene_scales_the_mesh(scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    point, normal, mask = plane_map(12, 12)
    point[:, :, 2] = 0.3 * rng.standard_normal((12, 12))
    point[4:, 4:, 2] += 40
    mask &= rng.random((12, 12)) > 0.1
    mesh, scaled = (mesh_from_point_map(factor * point, normal, mask) for factor in (1.0, scale))
    assert np.allclose(scaled.vertices_mm, scale * mesh.vertices_mm)
    assert np.array_equal(scaled.faces, mesh.faces)


def test_vertex_normals_of_a_sphere_are_radial() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    normal = vertex_normals(np.array(sphere.vertices), np.array(sphere.faces, np.int32))
    assert np.abs(normal - sphere.vertices).max() < 0.02


def test_input_is_not_modified() -> None:
    point, normal, mask = plane_map(4, 4)
    normal[1, 1] = np.nan
    before = point.copy(), normal.copy(), mask.copy()
    mesh_from_point_map(point, normal, mask)
    for left, right in zip(before, (point, normal, mask), strict=True):
        assert np.array_equal(left, right, equal_nan=True)
