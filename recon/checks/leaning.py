"""Points and normals that lean against each other across the object.

Both follow from the same two light paths, but not alike: an object that moved aside between air and liquid turns the normals
more than the surface through the points. The fused surface is a compromise of both, and what the crossings leave of it then
grows from one side of the object to the other.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from recon.maps import Maps
from recon.reconstruct import Crossing
from recon.status import PixelStatus

PATCHES_A_SIDE = 24
LEAST_SHARE = 0.6
FEWEST_PATCHES = 40
LARGEST_SD = 4.0


@dataclass(frozen=True, slots=True)
class Lean:
    """How the crossings stand off the surface, in their own sds, over one sd of the object's width; and that in its own sd."""

    slope: float
    sigma: float


def lean(crossing: Crossing, maps: Maps) -> Lean | None:
    """Return the trend across the object, along its steepest direction; None where too little is seen.

    Its standard deviation is from the scatter of patches about the trend, so that what neighbours share does not count as many.
    """
    rows, cols = maps.status.shape
    residual = _residuals(crossing, maps)
    used = np.isfinite(residual)
    row, col = np.divmod(crossing.pixels[used], cols)
    side = max(3, rows // PATCHES_A_SIDE)
    across = cols // side + 1
    patch = row // side * across + col // side
    count = np.bincount(patch)
    enough = count >= LEAST_SHARE * side**2
    if np.count_nonzero(enough) < FEWEST_PATCHES:
        return None
    held = np.clip(residual[used], -LARGEST_SD, LARGEST_SD)
    mean, y, x = (np.bincount(patch, values)[enough] / count[enough] for values in (held, row, col))
    design = np.column_stack([np.ones(len(mean)), _standard(x), _standard(y)])
    answer = np.linalg.lstsq(design, mean, rcond=None)[0]
    left = mean - design @ answer
    covariance = np.linalg.inv(design.T @ design) * float(left @ left) / (len(mean) - 3)
    slope = answer[1:]
    sigma = float(np.sqrt(slope @ np.linalg.solve(covariance[1:, 1:], slope)))
    return Lean(float(np.linalg.norm(slope)), sigma)


def _residuals(crossing: Crossing, maps: Maps) -> Float64[np.ndarray, " pixels"]:
    """Return how far each crossing stands off the surface along its path in liquid, over its sd; NaN where it has none."""
    points, direction = crossing.points, crossing.liquid.direction
    surface = maps.point_mm.reshape(-1, 3)[crossing.pixels]
    sd = np.sqrt(np.einsum("pi,pij,pj->p", direction, points.covariance, direction))
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = ((points.point_mm - surface) * direction).sum(axis=1) / sd
    return np.where(crossing.status == PixelStatus.OK, residual, np.nan)


def _standard(values: Float64[np.ndarray, " patches"]) -> Float64[np.ndarray, " patches"]:
    spread = float(values.std())
    return (values - values.mean()) / (spread if spread > 0 else 1.0)
