"""Normals to depth on the camera grid, as the published method does it: quadratic least squares inside the mask.

For two neighbouring pixels with mean normal n, the chord between their surface points is at right angles to n. This
holds exactly on planes and spheres. The equations see depth only up to a constant a connected part (a factor, in
perspective), which the triangulated points supply.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32

from recon.surface.neighbours import Neighbours, components, neighbours_of, normal_equations
from recon.surface.sparse_solver import solver

NormalMap = Float64[np.ndarray, "rows cols 3"]
DepthMap = Float64[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]
Vector3 = Float64[np.ndarray, " 3"]
PerPair = Float64[np.ndarray, " pairs"]
PerPixel = Float64[np.ndarray, " pixels"]

# A pair counts by the square of the cosine between normal and line of sight; below this cosine a surface is seen
# edge-on and its slope is noise.
GRAZING_COSINE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class IntegratedSurface:
    """Depth along the viewing rays and the points there; NaN outside the mask, ``part`` −1 there.

    ``part`` numbers the connected parts, each of which has its own free constant.
    """

    depth_mm: DepthMap
    point_mm: NormalMap
    part: Int32[np.ndarray, "rows cols"]


def integrate_orthographic(
    normal: NormalMap,
    mask: Mask,
    *,
    origin_mm: NormalMap,
    direction: Vector3,
    anchor_depth_mm: DepthMap | None = None,
) -> IntegratedSurface:
    """Integrate normals seen along parallel rays ``origin_mm + depth · direction``.

    ``anchor_depth_mm`` (NaN where unknown) sets each part's constant by the median of the difference; a part without any
    anchor has mean depth 0.
    """
    used = mask & np.isfinite(normal).all(axis=2) & np.isfinite(origin_mm).all(axis=2)
    sight = direction / np.linalg.norm(direction)
    graph, mean, cosine = _pairs(normal, np.broadcast_to(sight, normal.shape), used)
    origin = origin_mm[used]
    step = -(mean * (origin[graph.second] - origin[graph.first])).sum(1) / (mean @ direction)
    depth = _depth_from_steps(graph, step, cosine**2)
    part = components(graph.pixels, graph.first, graph.second)
    depth += _median_a_part(_anchor(anchor_depth_mm, used) - depth, part, otherwise=-_mean_a_part(depth, part))[part]
    return _surface(graph, depth, part, origin + depth[:, None] * direction)


def integrate_perspective(
    normal: NormalMap,
    mask: Mask,
    *,
    centre_mm: Vector3,
    direction: NormalMap,
    anchor_depth_mm: DepthMap | None = None,
) -> IntegratedSurface:
    """Integrate normals seen from one centre along rays ``centre_mm + depth · direction``.

    The unknown is the logarithm of depth, in which the chord's equation is linear: log(d_j / d_i) =
    log((n·r_i) / (n·r_j)). ``anchor_depth_mm`` (NaN where unknown) sets each part's factor by the median of the ratio; a
    part without any anchor has a geometric mean depth of 1.
    """
    used = mask & np.isfinite(normal).all(axis=2) & np.isfinite(direction).all(axis=2)
    length = np.linalg.norm(direction, axis=2, keepdims=True)
    graph, mean, cosine = _pairs(normal, direction / length, used)
    ray = direction[used]
    at_first = (mean * ray[graph.first]).sum(1)
    at_second = (mean * ray[graph.second]).sum(1)
    logarithm = _depth_from_steps(graph, np.log(at_first / at_second), cosine**2)
    part = components(graph.pixels, graph.first, graph.second)
    with np.errstate(invalid="ignore", divide="ignore"):
        anchor = np.log(_anchor(anchor_depth_mm, used))
    logarithm += _median_a_part(anchor - logarithm, part, otherwise=-_mean_a_part(logarithm, part))[part]
    depth = np.exp(logarithm)
    return _surface(graph, depth, part, centre_mm + depth[:, None] * ray)


def _pairs(normal: NormalMap, sight: NormalMap, used: Mask) -> tuple[Neighbours, np.ndarray, np.ndarray]:
    """Return the pairs seen well enough to carry a slope, their mean normals, and the cosine to the line of sight."""
    graph = neighbours_of(used)
    normals, sights = normal[used], sight[used]
    mean = normals[graph.first] + normals[graph.second]
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    mean = np.divide(mean, length, out=np.zeros_like(mean), where=length > 0)
    at_first = (mean * sights[graph.first]).sum(1)
    at_second = (mean * sights[graph.second]).sum(1)
    facing = np.minimum(np.abs(at_first), np.abs(at_second))
    good = (facing > GRAZING_COSINE) & (at_first * at_second > 0)
    return Neighbours(used, graph.first[good], graph.second[good]), mean[good], facing[good]


def _depth_from_steps(graph: Neighbours, step: PerPair, weight: PerPair) -> PerPixel:
    """Minimise Σ weight (d_second − d_first − step)², one pixel a part held at zero."""
    if not len(step):
        return np.zeros(graph.pixels)
    part = components(graph.pixels, graph.first, graph.second)
    held = np.zeros(graph.pixels)
    # The constant is free, so holding one pixel a part changes no difference of depth.
    held[np.unique(part, return_index=True)[1]] = 1.0
    ones = np.ones(len(step))
    matrix = normal_equations(graph, -ones, ones, weight, held)
    pull = weight * step
    right = np.bincount(graph.second, pull, minlength=graph.pixels)
    right -= np.bincount(graph.first, pull, minlength=graph.pixels)
    return solver(matrix)(right, np.zeros(graph.pixels))


def _anchor(anchor_depth_mm: DepthMap | None, used: Mask) -> np.ndarray:
    return np.full(int(used.sum()), np.nan) if anchor_depth_mm is None else anchor_depth_mm[used]


def _mean_a_part(values: np.ndarray, part: np.ndarray) -> np.ndarray:
    return np.bincount(part, values) / np.maximum(np.bincount(part), 1)


def _median_a_part(values: np.ndarray, part: np.ndarray, *, otherwise: np.ndarray) -> np.ndarray:
    """Return the median of each part's finite values, or ``otherwise`` where it has none."""
    result = otherwise.copy()
    finite = np.flatnonzero(np.isfinite(values))
    order = finite[np.lexsort((values[finite], part[finite]))]
    labels, start, count = np.unique(part[order], return_index=True, return_counts=True)
    low, high = order[start + (count - 1) // 2], order[start + count // 2]
    result[labels] = 0.5 * (values[low] + values[high])
    return result


def _surface(graph: Neighbours, depth: PerPixel, part: np.ndarray, point: np.ndarray) -> IntegratedSurface:
    point_map = np.full((*graph.mask.shape, 3), np.nan)
    point_map[graph.mask] = point
    part_map = np.full(graph.mask.shape, -1, np.int32)
    part_map[graph.mask] = part
    return IntegratedSurface(graph.on_grid(depth), point_map, part_map)
