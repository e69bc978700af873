"""The light paths of pixels that have no crossing: one medium's alone may be sound, and says where the surface can be."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int8, Int64

from recon.geometry.light_paths import LightPaths
from recon.reconstruct import paths_of
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from recon.sweeps.set_places import SweepResults, combined_status, correspondences

MEDIA = ("liquid", "air")


@dataclass(frozen=True, slots=True, eq=False)
class OwnPaths:
    """The paths in each medium of the pixels (ascending numbers) whose two sets there are both sound."""

    pixels: Mapping[str, Int64[np.ndarray, " paths"]]
    paths: Mapping[str, LightPaths]

    @classmethod
    def of(cls, sweeps: SweepResults, manifest: Manifest, pixels: Int64[np.ndarray, " pixels"]) -> "OwnPaths":
        """Make the paths of the listed pixels, as far as they are sound."""
        sound, paths = {}, {}
        for medium, n in zip(MEDIA, (manifest.n_liquid(), manifest.n_air), strict=True):
            sets = [one for one in manifest.sets if one.condition == medium]
            sound[medium] = pixels[combined_status(sweeps, sets)[pixels] == PixelStatus.OK]
            places = {one.name: correspondences(sweeps, one, manifest, sound[medium]) for one in sets}
            paths[medium] = paths_of(places, manifest, medium, n_medium=n, method="full")
        return cls(sound, paths)

    def passes(
        self,
        medium: str,
        pixels: Int64[np.ndarray, " asked"],
        point_mm: Float64[np.ndarray, "asked 3"],
        variance_mm2: Float64[np.ndarray, " asked"],
        *,
        sigma: float,
    ) -> Int8[np.ndarray, " asked"]:
        """Tell whether each pixel's own path passes its point, by so many sd of both: 1 yes, -1 no, 0 where it has none."""
        result = np.zeros(len(pixels), dtype=np.int8)
        numbers, paths = self.pixels[medium], self.paths[medium]
        if not len(numbers):
            return result
        place = np.minimum(np.searchsorted(numbers, pixels), len(numbers) - 1)
        has = numbers[place] == pixels
        direction = paths.direction[place]
        offset = point_mm - paths.near_mm[place]
        along = (offset * direction).sum(axis=1)
        across = offset - along[:, None] * direction
        lever = along / paths.baseline_mm[place]
        # The display's axes are unit vectors, so that a covariance's trace is the sum of both variances.
        near_mm2, far_mm2 = ((noise.sd_mm[place] ** 2).sum(axis=1) for noise in (paths.near_noise, paths.far_noise))
        own = (1 + lever) ** 2 * near_mm2 + lever**2 * far_mm2
        met = (across**2).sum(axis=1) < sigma**2 * (variance_mm2 + own)
        result[has] = np.where(met[has], 1, -1)
        return result
