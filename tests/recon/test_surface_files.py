"""Files are read back by programs that share no code with the writer: VTK through pyvista, and trimesh."""

from pathlib import Path

import numpy as np
import pytest
import pyvista
import trimesh

from recon.errors import ReconError
from recon.running.outcome_notes import drawn_mesh
from recon.surface.files import CHUNK, write_cloud_ply, write_mesh_glb, write_mesh_ply
from recon.surface.mesh import Mesh


def tetrahedron() -> Mesh:
    vertices = np.array([[0.0, 0, 0], [30, 0, 0], [0, 20, 0], [0, 0, 10]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    direction = vertices - vertices.mean(axis=0)
    return Mesh(vertices, faces, direction / np.linalg.norm(direction, axis=1, keepdims=True))


def cloud(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    normal = rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return rng.uniform(-50, 50, (count, 3)), normal, rng.random(count).astype(np.float32)


def test_cloud_comes_back_from_vtk_with_normals_and_sd(tmp_path: Path) -> None:
    point_mm, normal, sd_mm = cloud(1000)
    write_cloud_ply(tmp_path / "cloud.ply", point_mm, normal, sd_mm)
    read = pyvista.read(tmp_path / "cloud.ply")
    assert np.array_equal(read.points, point_mm.astype(np.float32))
    assert np.array_equal(read.point_data["Normals"], normal.astype(np.float32))


def test_cloud_comes_back_from_trimesh_with_every_field(tmp_path: Path) -> None:
    point_mm, normal, sd_mm = cloud(CHUNK + 7)  # across the border of two chunks
    write_cloud_ply(tmp_path / "cloud.ply", point_mm, normal, sd_mm)
    read = trimesh.load(tmp_path / "cloud.ply")
    assert np.array_equal(read.vertices, point_mm.astype(np.float32))
    fields = read.metadata["_ply_raw"]["vertex"]["data"]
    assert np.array_equal(np.ravel(fields["sd"]), sd_mm)
    assert np.array_equal(np.ravel(fields["ny"]), normal[:, 1].astype(np.float32))


def test_empty_cloud_is_a_file_that_says_so(tmp_path: Path) -> None:
    write_cloud_ply(tmp_path / "cloud.ply", *cloud(0))
    assert b"element vertex 0\n" in (tmp_path / "cloud.ply").read_bytes()


@pytest.mark.parametrize("read", [trimesh.load, pyvista.read], ids=["trimesh", "vtk"])
def test_mesh_ply_comes_back(tmp_path: Path, read) -> None:
    mesh = tetrahedron()
    write_mesh_ply(tmp_path / "mesh.ply", mesh)
    found = read(tmp_path / "mesh.ply")
    if isinstance(found, trimesh.Trimesh):
        vertices, faces = found.vertices, found.faces
    else:
        vertices, faces = found.points, found.faces.reshape(-1, 4)[:, 1:]
    assert np.array_equal(vertices, mesh.vertices_mm)
    assert np.array_equal(faces, mesh.faces)


def test_glb_is_in_metres_with_y_up(tmp_path: Path) -> None:
    mesh = tetrahedron()
    write_mesh_glb(tmp_path / "mesh.glb", mesh)
    assert (tmp_path / "mesh.glb").read_bytes()[:4] == b"glTF"
    scene = trimesh.load(tmp_path / "mesh.glb", process=False)
    # 30 mm right stays right, 20 mm down is below, 10 mm away is behind.
    assert np.allclose(scene.bounds, [[0, -0.020, -0.010], [0.030, 0, 0]], atol=1e-9)
    surface = scene.to_geometry()
    assert surface.volume == pytest.approx(0.03 * 0.02 * 0.01 / 6)  # positive: the faces still wind outwards
    assert len(surface.faces) == 4


def test_unwritable_place_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ReconError, match="cannot be written"):
        write_mesh_ply(tmp_path / "missing" / "mesh.ply", tetrahedron())


def test_no_temporary_file_is_left(tmp_path: Path) -> None:
    write_mesh_ply(tmp_path / "mesh.ply", tetrahedron())
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.ply"]


def test_mesh_without_faces_is_refused_as_glb(tmp_path: Path) -> None:
    none = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3)))
    with pytest.raises(ReconError, match="no triangle"):
        write_mesh_glb(tmp_path / "mesh.glb", none)


def test_a_mesh_without_faces_is_left_out_with_a_sentence_and_one_with_faces_is_kept() -> None:
    mesh, (sentence,) = drawn_mesh(Mesh(np.zeros((1, 3)), np.zeros((0, 3), np.int32), np.zeros((1, 3))))
    assert mesh is None
    assert "no mesh" in sentence
    whole = tetrahedron()
    assert drawn_mesh(whole) == (whole, ())
