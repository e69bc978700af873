"""Pixels that see two places of the scene at once: which of them the centre of the pixel looks at is not known.

At an outline, part of a pixel looks at the surface in front and part past it. In liquid, each part has a light path of its own.
The one with more light need not be that of the centre: light may be lost on the other, or a face seen edge-on may give none.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from recon.geometry.light_paths import LightPaths
from recon.maps import Maps
from recon.reconstruct import paths_of
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.set_places import (
    Correspondences,
    SweepResults,
    combined_status,
    correspondences,
    second_correspondences,
)

# The centre may as well look along the one path as along the other.
CHANCE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SecondPlaces:
    """Both light paths in the liquid of the pixels (ascending numbers) that have two: with more light, and with less."""

    pixels: Int64[np.ndarray, " two"]
    paths: tuple[LightPaths, LightPaths]

    @classmethod
    def of(cls, sweeps: SweepResults, manifest: Manifest) -> "SecondPlaces":
        """Find the pixels that see the display by two paths in the liquid, and make both paths."""
        sets = [one for one in manifest.sets if one.condition == "liquid"]
        pixels = np.flatnonzero(combined_status(sweeps, sets) == PixelStatus.TWO_PATHS)

        def made(places: Mapping[str, Correspondences]) -> LightPaths:
            return paths_of(places, manifest, "liquid", n_medium=manifest.n_liquid(), method="full")

        more, less = (
            made({one.name: places_of(sweeps, one, manifest, pixels) for one in sets})
            for places_of in (correspondences, second_correspondences)
        )
        return cls(pixels, (more, less))

    def variance_mm2(self, point_mm: Float64[np.ndarray, "two 3"]) -> Float64[np.ndarray, " two"]:
        """Return how far off, in the mean square, these pixels' points are for not knowing by which path the centre looks.

        What the pixel sees by the other path lies on that path, no nearer to the point than the path itself. Where both leave
        one surface, at a crease as well, they do so within the pixel, and that is next to nothing.
        """
        return CHANCE * np.maximum(*(_distance_squared(path, point_mm) for path in self.paths))

    def widened(self, maps: Maps) -> Maps:
        """Return the maps with that added to the variances of the points that such pixels measured; normals stay as they are."""
        if not len(self.pixels):
            return maps
        at = np.unravel_index(self.pixels, maps.status.shape)
        measured = maps.status[at] == PixelStatus.OK
        added_mm2 = np.where(measured, self.variance_mm2(maps.point_mm[at]), 0.0)

        def wider(sd_mm: np.ndarray) -> np.ndarray:
            result = sd_mm.copy()
            result[at] = np.sqrt(sd_mm[at].astype(np.float64) ** 2 + added_mm2)
            return result

        # Which way the other place lies is not known either.
        across_sd_mm = None if maps.across_sd_mm is None else wider(maps.across_sd_mm)
        return replace(maps, sd_mm=wider(maps.sd_mm), across_sd_mm=across_sd_mm)


def _distance_squared(path: LightPaths, point_mm: Float64[np.ndarray, "two 3"]) -> Float64[np.ndarray, " two"]:
    """Return the squared distance of each point from its pixel's path."""
    offset = point_mm - path.near_mm
    along = (offset * path.direction).sum(axis=1)
    return ((offset - along[:, None] * path.direction) ** 2).sum(axis=1)
