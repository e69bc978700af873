"""Normals to depth by discrete geometry: facets with corners of their own, turned to their normals and joined again.

Xie, Zhang, Wang, Chung: *Surface-from-Gradients: An Approach Based on Discrete Geometry Processing* (CVPR 2014), which the paper
uses. Each pixel is a facet whose four corners lie on the rays between pixels. Local shaping: about its centre the facet is turned
to its normal, which tells the heights of its corners but for their mean. Global blending: the corners of all facets are joined by
least squares on the mean-free heights. Along the rays, the facets' shapes do not depend on where they lie, so one solution is
enough.

With N the matrix that takes the mean off four corners, ‖N (h − δ)‖² is a quarter of the sum over the six pairs of corners of
(h_a − h_b − δ_a + δ_b)²: edges and diagonals of every facet are steps that are wanted.
"""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float64

from recon.surface.neighbours import Neighbours, components
from recon.surface.quadratic_integration import GRAZING_COSINE
from recon.surface.ray_bundle import Mask, RayBundle
from recon.surface.steps import heights_from_steps

# Rows and columns that the corners lie beside a pixel's centre, in pixels.
CORNERS = ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5))
PAIR_WEIGHT = 0.25

Vectors = Float64[np.ndarray, "pixels 3"]


def integrate_discrete(
    normal: Vectors, rays: RayBundle, used: Mask
) -> tuple[Float64[np.ndarray, "rows cols"], np.ndarray]:
    """Return the unknown of each used pixel up to a constant a part, and the number of its part; NaN and −1 elsewhere.

    A pixel that is seen edge-on has no facet. Facets that share one corner are of one part.
    """
    wanted = _corner_heights(normal, rays, used)
    good = np.isfinite(wanted).all(axis=1) & (
        np.abs(rays.of(used).facing(normal, np.arange(len(normal)))) > GRAZING_COSINE
    )
    facets = used.copy()
    facets[used] = good
    wanted = wanted[good]
    corner_mask, corner = _corners(facets)
    ends = np.array(list(combinations(range(4), 2)))
    graph = Neighbours(corner_mask, corner[:, ends[:, 0]].T.ravel(), corner[:, ends[:, 1]].T.ravel())
    step = (wanted[:, ends[:, 1]] - wanted[:, ends[:, 0]]).T.ravel()
    height = heights_from_steps(graph, step, np.full(len(step), PAIR_WEIGHT))
    unknown, part = np.full(used.shape, np.nan), np.full(used.shape, -1, np.int32)
    if len(corner):
        # About its own mean a facet's corners lie evenly, so that their mean is the height of its centre.
        unknown[facets] = height[corner].mean(axis=1) - wanted.mean(axis=1)
        part[facets] = components(graph.pixels, graph.first, graph.second)[corner[:, 0]]
    return unknown, part


def _corner_heights(normal: Vectors, rays: RayBundle, used: Mask) -> Float64[np.ndarray, "pixels 4"]:
    """Return how far each facet's corners lie beyond its centre once it is turned to its normal; NaN where they cannot."""
    field = np.concatenate([rays.place_mm, rays.start[..., None]], axis=2)
    down, along = (_derivative(field, used, axis)[used] for axis in (0, 1))
    sights = rays.of(used)
    heights = np.empty((len(normal), 4))
    for number, (row, column) in enumerate(CORNERS):
        shift = row * down + column * along
        heights[:, number] = sights.step_beside(normal, shift[:, :3], shift[:, 3])
    return heights


def _derivative(field: Float64[np.ndarray, "rows cols 4"], used: Mask, axis: int) -> np.ndarray:
    """Return the change of a field from pixel to pixel: the mean of the steps to both neighbours, or to the one that is there."""
    turned, mask = np.moveaxis(field, axis, 0), np.moveaxis(used, axis, 0)
    step, there = np.diff(turned, axis=0), mask[1:] & mask[:-1]
    total, count = np.zeros_like(turned), np.zeros(mask.shape)
    for part in (slice(1, None), slice(None, -1)):
        total[part] += np.where(there[..., None], step, 0.0)
        count[part] += there
    typical = np.median(step[there], axis=0) if there.any() else np.full(field.shape[2], np.nan)
    mean = np.where(count[..., None] > 0, total / np.maximum(count, 1.0)[..., None], typical)
    return np.moveaxis(mean, 0, axis)


def _corners(facets: Mask) -> tuple[Bool[np.ndarray, "corner_rows corner_cols"], np.ndarray]:
    """Return the grid of corners that facets have, and the numbers of each facet's four, in the order of ``CORNERS``."""
    rows, columns = facets.shape
    mask = np.zeros((rows + 1, columns + 1), bool)
    places = [(slice(r, r + rows), slice(c, c + columns)) for r in (0, 1) for c in (0, 1)]
    for place in places:
        mask[place] |= facets
    number = np.full(mask.shape, -1, np.int32)
    number[mask] = np.arange(mask.sum(), dtype=np.int32)
    return mask, np.stack([number[place][facets] for place in places], axis=1)
