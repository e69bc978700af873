"""A triangle mesh, and how it comes from a map of points on the camera grid."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64
from scipy.ndimage import uniform_filter

from recon.compiled import compiled

PointMap = Float64[np.ndarray, "rows cols 3"]
PixelMask = Bool[np.ndarray, "rows cols"]

# An edge this many times longer than the edges around it spans a jump of depth, not the surface. At the rim of a sphere
# seen head on, where a smooth surface bends away fastest, successive edges grow by at most 1 / (√2 − 1) = 2.4.
JUMP_RATIO = 5.0
NEIGHBOURHOOD_PX = 7


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in the frame of the display poses. ``normal`` is one unit vector a vertex; faces wind with it."""

    vertices_mm: Float64[np.ndarray, "vertices 3"]
    faces: Int32[np.ndarray, "faces 3"]
    normal: Float64[np.ndarray, "vertices 3"]


def mesh_from_point_map(
    point_mm: PointMap, normal: PointMap, mask: PixelMask, *, jump_ratio: float = JUMP_RATIO
) -> Mesh:
    """Join neighbouring pixels that have a point to triangles.

    Four pixels give two triangles along the shorter diagonal, three pixels give one. A triangle with an edge more than
    ``jump_ratio`` times longer than the edges around it (geometric mean of a neighbourhood, so that neither the unit
    nor a slant matters) is left out, and so are points that no triangle uses.

    Parameters
    ----------
    point_mm, normal
        One point and one unit normal a pixel; where a normal is NaN, the mean of the adjoining faces takes its place.
    mask
        The pixels to use; those whose point is not finite are left out.
    """
    used = mask & np.isfinite(point_mm).all(axis=2)
    triangles = _grid_triangles(np.ascontiguousarray(point_mm), used, jump_ratio=jump_ratio)
    is_vertex = np.zeros(used.size, dtype=bool)
    is_vertex[triangles] = True
    pixels = np.flatnonzero(is_vertex)
    number = np.empty(used.size, np.int32)
    number[pixels] = np.arange(len(pixels), dtype=np.int32)
    faces = number[triangles]
    vertices_mm = point_mm.reshape(-1, 3)[pixels]
    vertex_normal = normal.reshape(-1, 3)[pixels]
    if _opposes(vertices_mm, faces, vertex_normal):
        faces = np.ascontiguousarray(faces[:, ::-1])
    missing = ~np.isfinite(vertex_normal).all(axis=1)
    if missing.any():
        vertex_normal[missing] = vertex_normals(vertices_mm, faces)[missing]
    return Mesh(vertices_mm, faces, vertex_normal)


def vertex_normals(
    vertices_mm: Float64[np.ndarray, "vertices 3"], faces: Int32[np.ndarray, "faces 3"]
) -> Float64[np.ndarray, "vertices 3"]:
    """Return the unit mean of the adjoining faces' normals, weighted by area; NaN at a vertex without area."""
    across = _face_vectors(vertices_mm, faces)
    total = np.zeros_like(vertices_mm)
    for column in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, column], across[:, axis], minlength=len(vertices_mm))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.full_like(total, np.nan), where=length > 0)


def _face_vectors(
    vertices_mm: Float64[np.ndarray, "vertices 3"], faces: Int32[np.ndarray, "faces 3"]
) -> Float64[np.ndarray, "faces 3"]:
    """Return each face's normal times twice its area."""
    first, second, third = (vertices_mm[faces[:, k]] for k in range(3))
    return np.cross(second - first, third - first)


@compiled
def _opposes(vertex: np.ndarray, faces: np.ndarray, normal: np.ndarray) -> bool:
    """Tell whether the faces wind against the normals, by area; a normal that is not a number says nothing."""
    total = 0.0
    for face in range(len(faces)):
        one, two, three = faces[face]
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            across = (vertex[two, a] - vertex[one, a]) * (vertex[three, b] - vertex[one, b])
            across -= (vertex[two, b] - vertex[one, b]) * (vertex[three, a] - vertex[one, a])
            along = across * normal[one, k]
            total += along if abs(along) < np.inf else 0.0
    return total < 0


def _grid_triangles(point_mm: PointMap, used: PixelMask, *, jump_ratio: float) -> Int64[np.ndarray, "faces 3"]:
    """Return triangles of pixel numbers (row-major), all with the same sense of rotation."""
    along = _sound_edges(point_mm, used, axis=1, jump_ratio=jump_ratio)
    down = _sound_edges(point_mm, used, axis=0, jump_ratio=jump_ratio)
    chosen = np.zeros(used.shape, np.uint8)
    _choose_corners(point_mm, along, down, chosen)
    below = used.shape[1]
    # The other two vertices of each corner's triangle, by how far on their pixels are, and the corner's own.
    corners = ((0, below, 1), (below + 1, 1, below), (1, 0, below + 1), (below, below + 1, 0))
    return np.concatenate(
        [np.flatnonzero(chosen & (1 << corner))[:, None] + np.array(offsets) for corner, offsets in enumerate(corners)]
    )


@compiled
def _choose_corners(point: np.ndarray, along: np.ndarray, down: np.ndarray, chosen: np.ndarray) -> None:
    """Write which corners' triangles each square of pixels has, a bit each: north-west, south-east, north-east, south-west.

    A corner's triangle is sound when its two grid edges are; its third edge is then at most their sum. The first two are cut
    apart by the rising diagonal, the others by the falling one.
    """
    rows, cols = chosen.shape
    for row in range(rows - 1):
        for col in range(cols - 1):
            top, bottom, left, right = along[row, col], along[row + 1, col], down[row, col], down[row, col + 1]
            if top and bottom and left and right:
                falling = rising = 0.0
                for k in range(3):
                    falling += (point[row, col, k] - point[row + 1, col + 1, k]) ** 2
                    rising += (point[row, col + 1, k] - point[row + 1, col, k]) ** 2
                chosen[row, col] = 12 if np.sqrt(falling) < np.sqrt(rising) else 3
            elif top and left:
                chosen[row, col] = 1
            elif bottom and right:
                chosen[row, col] = 2
            elif top and right:
                chosen[row, col] = 4
            elif bottom and left:
                chosen[row, col] = 8


def _sound_edges(point_mm: PointMap, used: PixelMask, *, axis: int, jump_ratio: float) -> np.ndarray:
    """Mark the edges between neighbours along ``axis`` whose both ends are used and that span no jump."""
    first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
    second = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
    both, length_mm = used[first] & used[second], np.zeros(used[first].shape)
    _write_lengths(point_mm, both, 1 - axis, axis, length_mm)
    positive = both & (length_mm > 0)
    # The mean of logarithms over a window: a jump crosses only one row in seven of it.
    log_length = np.log(length_mm, out=np.zeros(both.shape), where=positive)
    share = uniform_filter(positive.astype(np.float64), NEIGHBOURHOOD_PX, mode="constant")
    total = uniform_filter(np.where(positive, log_length, 0.0), NEIGHBOURHOOD_PX, mode="constant")
    typical = np.divide(total, share, out=np.zeros(both.shape), where=share > 0.5 / NEIGHBOURHOOD_PX**2)
    return both & (~positive | (log_length <= typical + np.log(jump_ratio)))


@compiled
def _write_lengths(point: np.ndarray, both: np.ndarray, down: int, right: int, length: np.ndarray) -> None:
    """Write how far each pixel's point is from that of the pixel so far down and to the right, where there are both."""
    for row in range(both.shape[0]):
        for col in range(both.shape[1]):
            if both[row, col]:
                squared = 0.0
                for k in range(3):
                    squared += (point[row + down, col + right, k] - point[row, col, k]) ** 2
                length[row, col] = np.sqrt(squared)
