"""Point clouds and meshes as files that other programs read: PLY (binary) and GLB.

PLY: Greg Turk, "The PLY Polygon File Format" (1994), ``format binary_little_endian 1.0``.
GLB: glTF 2.0, written by trimesh.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
import trimesh
from jaxtyping import Float32, Float64, UInt8

from recon.errors import ReconError
from recon.surface.mesh import Mesh

CLOUD_NAME, MESH_NAME, GLB_NAME = "cloud.ply", "mesh.ply", "mesh.glb"
VERTEX = np.dtype([(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")])
CLOUD_POINT = np.dtype([*VERTEX.descr, ("sd", "<f4")])
CLOUD_POINT_WITH_SUPPORT = np.dtype([*CLOUD_POINT.descr, ("support", "<f4")])
FACE = np.dtype([("count", "u1"), ("vertices", "<i4", (3,))])

# Rows turned into records at a time, so that a cloud of any size needs little memory beside its arrays.
CHUNK = 1 << 16

# glTF wants metres, y up and z towards the viewer; ours are millimetres, x right, y down, z away from the viewer.
GLTF_FROM_WORLD = np.diag([1e-3, -1e-3, -1e-3, 1.0])


def write_cloud_ply(
    path: Path,
    point_mm: Float64[np.ndarray, "points 3"],
    normal: Float64[np.ndarray, "points 3"],
    sd_mm: Float32[np.ndarray, " points"],
    *,
    support: UInt8[np.ndarray, " points"] | None = None,
) -> None:
    """Write points with their normals and standard deviations as binary PLY (x y z nx ny nz sd, float32).

    ``support``, where it is known, is what each point rests on (:class:`~recon.maps.Support`), as one more float32: readers of
    points take properties of mixed types apart less surely.
    """
    record = CLOUD_POINT if support is None else CLOUD_POINT_WITH_SUPPORT
    extra = () if support is None else (support[:, None],)
    with _whole_or_absent(path) as file:
        file.write(_header([("vertex", len(point_mm), _scalars(record))]))
        _write_rows(file, record, (point_mm, normal, sd_mm[:, None], *extra))


def write_mesh_ply(path: Path, mesh: Mesh) -> None:
    """Write a mesh with vertex normals as binary PLY (x y z nx ny nz, float32; triangles of int32)."""
    triangle = ["property list uchar int vertex_indices"]
    with _whole_or_absent(path) as file:
        file.write(_header([("vertex", len(mesh.vertices_mm), _scalars(VERTEX)), ("face", len(mesh.faces), triangle)]))
        _write_rows(file, VERTEX, (mesh.vertices_mm, mesh.normal))
        records = np.empty(len(mesh.faces), FACE)
        records["count"] = 3
        records["vertices"] = mesh.faces
        file.write(records.tobytes())


def read_mesh_ply(path: Path) -> Mesh:
    """Read a mesh that :func:`write_mesh_ply` wrote; raises ``ReconError`` with one sentence where it cannot."""
    try:
        loaded = trimesh.load_mesh(path, process=False)
        return Mesh(
            np.asarray(loaded.vertices, dtype=np.float64),
            np.asarray(loaded.faces, dtype=np.int32),
            np.asarray(loaded.vertex_normals, dtype=np.float64),
        )
    except (OSError, ValueError, AttributeError) as error:
        raise ReconError(f"{path}: not a mesh that can be read ({error}); run `recon run` again") from None


def write_mesh_glb(path: Path, mesh: Mesh) -> None:
    """Write a mesh as binary glTF 2.0, which browsers, Blender and phones open.

    The vertices keep their numbers in mm; the node that holds the mesh turns them into glTF's metres and axes.
    Raises ``ReconError`` for a mesh without faces, which the format cannot hold.
    """
    if not len(mesh.faces):
        raise ReconError(f"{path}: the surface has no triangle to write; see the status map for why pixels were lost")
    surface = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, vertex_normals=mesh.normal, process=False)
    scene = trimesh.Scene()
    scene.add_geometry(surface, node_name="surface", geom_name="surface", transform=GLTF_FROM_WORLD)
    data = trimesh.exchange.gltf.export_glb(scene, include_normals=True)
    with _whole_or_absent(path) as file:
        file.write(data)


def _scalars(record: np.dtype) -> list[str]:
    """Return the header lines of a record of float32."""
    return [f"property float {name}" for name in record.names or ()]


def _header(elements: list[tuple[str, int, list[str]]]) -> bytes:
    """Return a PLY header: per element its name, count and property lines."""
    lines = ["ply", "format binary_little_endian 1.0", "comment lengths in millimetres"]
    for name, count, properties in elements:
        lines += [f"element {name} {count}", *properties]
    return "\n".join([*lines, "end_header", ""]).encode("ascii")


def _write_rows(file: BinaryIO, record: np.dtype, blocks: tuple[np.ndarray, ...]) -> None:
    """Write blocks of columns side by side, one packed record of float32 a row."""
    width = record.itemsize // 4
    for start in range(0, len(blocks[0]), CHUNK):
        part = [block[start : start + CHUNK] for block in blocks]
        rows = np.concatenate(part, axis=1, dtype="<f4", casting="same_kind")
        assert rows.shape[1] == width
        file.write(rows.tobytes())


@contextmanager
def _whole_or_absent(path: Path) -> Iterator[BinaryIO]:
    """Write under a temporary name and rename at the end, so that nobody reads half a file."""
    temporary = path.with_name(path.name + ".part")
    try:
        with temporary.open("wb") as file:
            yield file
        temporary.replace(path)
    except OSError as error:
        raise ReconError(
            f"{path}: cannot be written ({error.strerror}); check the folder and the free space"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
