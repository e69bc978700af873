"""What the 3-D view gets: points and a mesh, thinned and written as 16-bit places and 8-bit normals."""

import base64
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64, Int8, Int64, Integer, UInt16
from scipy.spatial import cKDTree

from recon.compiled import compiled

# Together about 2.5 MB as text: light enough to send, dense enough to look closed at the size of a page.
POINTS_SHOWN = 100_000
MESH_VERTICES_SHOWN = 40_000
# Points beyond these percentiles, and the room round them, are left out so that outliers do not shrink the object.
BOX_PERCENTILES = (0.1, 99.9)
BOX_ROOM = 0.15
SEED = 1
LARGEST_UINT16 = 65_535


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points with unit normals and standard deviations (NaN where there is none), in one frame."""

    point_mm: Float64[np.ndarray, "points 3"]
    normal: Float64[np.ndarray, "points 3"]
    sd_mm: Float[np.ndarray, " points"]

    def __getitem__(self, chosen: Bool[np.ndarray, " points"] | Int64[np.ndarray, " chosen"]) -> "Cloud":
        """Return some of the points."""
        return Cloud(self.point_mm[chosen], self.normal[chosen], self.sd_mm[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """Vertices with normals, and triangles as indices of vertices."""

    vertex_mm: Float64[np.ndarray, "vertices 3"]
    face: Int64[np.ndarray, "faces 3"]
    normal: Float64[np.ndarray, "vertices 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """The rectangle in space that is shown."""

    low_mm: Float64[np.ndarray, " 3"]
    high_mm: Float64[np.ndarray, " 3"]

    def inside(self, point_mm: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
        """Return which points it holds."""
        return np.all((point_mm >= self.low_mm) & (point_mm <= self.high_mm), axis=1)


def box_of(point_mm: Float64[np.ndarray, "points 3"]) -> Box:
    """Return the box of all points but outliers."""
    low, high = np.percentile(point_mm, BOX_PERCENTILES, axis=0)
    room = BOX_ROOM * max(float((high - low).max()), 1e-9)
    return Box(np.maximum(low - room, point_mm.min(axis=0)), np.minimum(high + room, point_mm.max(axis=0)))


def cluster_mesh(mesh: TriangleMesh, *, most: int) -> TriangleMesh:
    """Merge vertices that share a cell of a grid until at most about ``most`` are left.

    The cell follows from the mesh's area, as one cell holds one piece of surface about as large as its face. A merged
    vertex is the mean of its vertices; triangles that shrink to a line are dropped.
    """
    if len(mesh.vertex_mm) <= most:
        return mesh
    cell_mm = np.sqrt(1.5 * _area(mesh.vertex_mm, mesh.face) / most)
    cell = np.floor((mesh.vertex_mm - mesh.vertex_mm.min(axis=0)) / cell_mm).astype(np.int64)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    _, merged, count = np.unique(key, return_inverse=True, return_counts=True)
    vertex_mm, normal = (
        np.stack([np.bincount(merged, weights=values[:, axis]) for axis in range(3)], axis=1) / count[:, None]
        for values in (mesh.vertex_mm, mesh.normal)
    )
    face = merged[mesh.face]
    kept = (face[:, 0] != face[:, 1]) & (face[:, 1] != face[:, 2]) & (face[:, 2] != face[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return TriangleMesh(vertex_mm, face[kept].astype(np.int64), normal / np.where(length > 0, length, 1.0))


@compiled
def _area(vertex: np.ndarray, faces: np.ndarray) -> float:
    """Return the area of all triangles; whole arrays of their corners would take more memory than the mesh."""
    total = 0.0
    for face in range(len(faces)):
        one, two, three = faces[face]
        squared = 0.0
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            across = (vertex[two, a] - vertex[one, a]) * (vertex[three, b] - vertex[one, b])
            across -= (vertex[two, b] - vertex[one, b]) * (vertex[three, a] - vertex[one, a])
            squared += across**2
        total += 0.5 * np.sqrt(squared)
    return total


def sd_at(vertex_mm: Float64[np.ndarray, "vertices 3"], cloud: Cloud) -> Float[np.ndarray, " vertices"]:
    """Return the standard deviation of the point nearest to each vertex."""
    return cloud.sd_mm[cKDTree(cloud.point_mm).query(vertex_mm)[1]]


def packed_normals(normal: Float64[np.ndarray, "points 3"]) -> Int8[np.ndarray, "points 2"]:
    """Return unit normals as two signed bytes: the octahedral map (Cigolle et al., JCGT 2014), right within a degree."""
    known = np.nan_to_num(normal)
    size = np.abs(known).sum(axis=1, keepdims=True)
    flat = known / np.where(size > 0, size, 1.0)
    sign = np.where(flat[:, :2] >= 0, 1.0, -1.0)
    folded = np.where(flat[:, 2:] < 0, (1 - np.abs(flat[:, 1::-1])) * sign, flat[:, :2])
    return np.round(127 * folded).astype(np.int8)


def packed_places(
    point_mm: Float64[np.ndarray, "points 3"],
    sd_mm: Float[np.ndarray, " points"],
    box: Box,
    *,
    sd_limits_mm: tuple[float, float],
) -> UInt16[np.ndarray, "points 4"]:
    """Return place in the box and place of log sd between its limits, each from 0 to 65,535."""
    span = np.maximum(box.high_mm - box.low_mm, 1e-12)
    low, high = np.log(sd_limits_mm)
    grey = (np.log(np.clip(np.nan_to_num(sd_mm, nan=sd_limits_mm[1]), *sd_limits_mm)) - low) / max(high - low, 1e-12)
    parts = np.column_stack([(point_mm - box.low_mm) / span, grey])
    return np.round(LARGEST_UINT16 * np.clip(parts, 0, 1)).astype(np.uint16)


def packed_faces(face: Int64[np.ndarray, "faces 3"], vertices: int) -> Integer[np.ndarray, "faces 3"]:
    """Return the triangles in the smallest type that holds every index."""
    return face.astype(np.uint16 if vertices <= LARGEST_UINT16 else np.uint32)


def as_text(values: np.ndarray) -> str:
    """Return an array's bytes, little-endian, as base64."""
    return base64.b64encode(np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"))).tobytes()).decode(
        "ascii"
    )
