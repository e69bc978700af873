"""By how much each pair's equation pulls at its two distances, told without the pixels' own noise.

A normal that is off by noise leaves a residual in its pair's equation, and the same noise is in the factors by which that
residual pulls at the distances. The product does not average out: the surface is drawn to where its paths lie closer together.
Factors that are means over the pixels about each hold hardly any of that noise. They need not be exact: what is sought
is where the pulls of all residuals cancel, and the residuals are those of the measured normals and paths.
"""

from dataclasses import dataclass

import numpy as np

from recon.compiled import compiled
from recon.surface.neighbours import Neighbours
from recon.surface.ray_chords import PerPair, ScalarMap, VectorMap
from recon.surface.window_means import weighted_means

# So many pixels across are averaged, noise of which is then a ninth.
STEADY_WINDOW_PX = 9
# A mean counts where noise alone sets a normal so far apart from it: across an edge it belongs to neither side.
NOISE_SD = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Pulls:
    """The factors of a pair's two distances in its equation, at_first t_first + at_second t_second, without noise."""

    at_first: PerPair
    at_second: PerPair

    @classmethod
    def of(cls, graph: Neighbours, direction: VectorMap, normal: VectorMap, normal_sd_rad: ScalarMap) -> "Pulls":
        """Average the directions of the paths and the normals about each pixel, where they differ by noise alone."""
        used = graph.mask
        told = np.where(used[..., None], np.concatenate([direction, normal], axis=2), 0.0)
        mean = weighted_means(np.moveaxis(told, -1, 0), used.astype(np.float64), window_px=STEADY_WINDOW_PX)
        mean = np.moveaxis(mean, 0, -1)
        apart_squared = ((mean[..., 3:] - told[..., 3:]) ** 2).sum(axis=2)
        with np.errstate(invalid="ignore"):
            alike = apart_squared < (NOISE_SD * normal_sd_rad) ** 2
        steady = np.where(alike[..., None], mean, told)[used]
        result = cls(np.empty(len(graph.first)), np.empty(len(graph.first)))
        _write_pulls(graph.first, graph.second, steady, result.at_first, result.at_second)
        return result


@compiled
def _write_pulls(
    first: np.ndarray, second: np.ndarray, steady: np.ndarray, at_first: np.ndarray, at_second: np.ndarray
) -> None:
    """Write them, for the direction and the normal of each pixel, one after the other."""
    for pair in range(len(first)):
        one, other = first[pair], second[pair]
        before = after = squared = 0.0
        for k in range(3):
            both = steady[one, 3 + k] + steady[other, 3 + k]
            squared += both**2
            before -= both * steady[one, k]
            after += both * steady[other, k]
        longer = max(np.sqrt(squared), 1e-30)
        at_first[pair], at_second[pair] = before / longer, after / longer
