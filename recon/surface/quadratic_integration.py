"""Normals to depth by quadratic least squares: a chord between neighbours is at right angles to the mean of their normals.

This holds exactly on planes and spheres. Elsewhere the error falls with the square of the spacing.
"""

import numpy as np
from jaxtyping import Float64

from recon.surface.neighbours import Neighbours, components, neighbours_of
from recon.surface.ray_bundle import Mask, RayBundle
from recon.surface.steps import heights_from_steps

# A pair counts by the square of the cosine between normal and line of sight; below this cosine a surface is seen
# edge-on and its slope is noise.
GRAZING_COSINE = 0.02

Vectors = Float64[np.ndarray, "pixels 3"]


def integrate_quadratic(
    normal: Vectors, rays: RayBundle, used: Mask
) -> tuple[Float64[np.ndarray, "rows cols"], np.ndarray]:
    """Return the unknown of each used pixel up to a constant a part, and the number of its part; NaN and −1 elsewhere."""
    graph = neighbours_of(used)
    sights = rays.of(used)
    mean = normal[graph.first] + normal[graph.second]
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    mean = np.divide(mean, length, out=np.zeros_like(mean), where=length > 0)
    at_first, at_second = sights.facing(mean, graph.first), sights.facing(mean, graph.second)
    facing = np.minimum(np.abs(at_first), np.abs(at_second))
    good = (facing > GRAZING_COSINE) & (at_first * at_second > 0)
    graph = Neighbours(used, graph.first[good], graph.second[good])
    unknown = heights_from_steps(graph, sights.step(mean[good], graph.first, graph.second), facing[good] ** 2)
    return on_grids(graph, unknown, components(graph.pixels, graph.first, graph.second))


def on_grids(
    graph: Neighbours, unknown: Float64[np.ndarray, " pixels"], part: np.ndarray
) -> tuple[Float64[np.ndarray, "rows cols"], np.ndarray]:
    """Put unknowns and numbers of parts on the camera's grid."""
    parts = np.full(graph.mask.shape, -1, np.int32)
    parts[graph.mask] = part
    return graph.on_grid(unknown), parts
