"""A triangle mesh, and how it comes from a map of points on the camera grid."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32
from scipy.ndimage import uniform_filter

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
    triangles = _grid_triangles(point_mm, used, jump_ratio=jump_ratio)
    pixels, faces = np.unique(triangles, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
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


def _opposes(
    vertices_mm: Float64[np.ndarray, "vertices 3"],
    faces: Int32[np.ndarray, "faces 3"],
    normal: Float64[np.ndarray, "vertices 3"],
) -> bool:
    """Tell whether the faces wind against the normals, by area."""
    across = _face_vectors(vertices_mm, faces)
    return bool(np.nansum(across * normal[faces[:, 0]]) < 0)


def _grid_triangles(point_mm: PointMap, used: PixelMask, *, jump_ratio: float) -> np.ndarray:
    """Return triangles [n, 3] of pixel numbers (row-major), all with the same sense of rotation."""
    number = np.arange(used.size, dtype=np.int64).reshape(used.shape)
    along = _sound_edges(point_mm, used, axis=1, jump_ratio=jump_ratio)
    down = _sound_edges(point_mm, used, axis=0, jump_ratio=jump_ratio)
    top, bottom, left, right = along[:-1], along[1:], down[:, :-1], down[:, 1:]
    north_west, north_east = number[:-1, :-1], number[:-1, 1:]
    south_west, south_east = number[1:, :-1], number[1:, 1:]
    # A triangle is sound when its two grid edges are; its third edge is then at most their sum.
    corner = {
        "north_west": (top & left, (north_west, south_west, north_east)),
        "south_east": (bottom & right, (south_east, north_east, south_west)),
        "north_east": (top & right, (north_east, north_west, south_east)),
        "south_west": (bottom & left, (south_west, south_east, north_west)),
    }
    falling = np.linalg.norm(point_mm[:-1, :-1] - point_mm[1:, 1:], axis=2)
    rising = np.linalg.norm(point_mm[:-1, 1:] - point_mm[1:, :-1], axis=2)
    with_rising = corner["north_west"][0] & corner["south_east"][0]
    with_falling = corner["north_east"][0] & corner["south_west"][0]
    choose_rising = with_rising & ~(with_falling & (falling < rising))
    choose_falling = with_falling & ~choose_rising
    alone = ~(choose_rising | choose_falling)
    triangles = []
    for name, (sound, vertices) in corner.items():
        whole = choose_rising if name in ("north_west", "south_east") else choose_falling
        chosen = whole | (alone & sound)
        triangles.append(np.stack([vertex[chosen] for vertex in vertices], axis=1))
        alone &= ~sound
    return np.concatenate(triangles)


def _sound_edges(point_mm: PointMap, used: PixelMask, *, axis: int, jump_ratio: float) -> np.ndarray:
    """Mark the edges between neighbours along ``axis`` whose both ends are used and that span no jump."""
    first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
    second = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
    both = used[first] & used[second]
    length_mm = np.linalg.norm(point_mm[second] - point_mm[first], axis=2)
    positive = both & (length_mm > 0)
    # The mean of logarithms over a window: a jump crosses only one row in seven of it.
    log_length = np.log(length_mm, out=np.zeros(both.shape), where=positive)
    share = uniform_filter(positive.astype(np.float64), NEIGHBOURHOOD_PX, mode="constant")
    total = uniform_filter(np.where(positive, log_length, 0.0), NEIGHBOURHOOD_PX, mode="constant")
    typical = np.divide(total, share, out=np.zeros(both.shape), where=share > 0.5 / NEIGHBOURHOOD_PX**2)
    return both & (~positive | (log_length <= typical + np.log(jump_ratio)))
