"""The first entry point (FEP): where a pixel's path in liquid and its path in air come closest.

Geometry of two skew lines P + sU and Q + tV. In their common directions the crossing is fixed by both lines; along
c = U×V/|U×V| each line says where it is, and the gap between them measures how well they agree.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from recon.bands import over_bands
from recon.compiled import compiled
from recon.geometry.light_paths import LightPaths

# sin² of the angle below which two lines have no crossing in double precision.
PARALLEL = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class EntryPoints:
    """The crossing of two light paths and how sure it is.

    ``gap_mm`` is signed (from liquid to air path along U×V); ``gap_sd_mm`` is what noise alone would give; ``angle_rad``
    between the paths has the standard deviation ``angle_sd_rad``; ``covariance`` [pixels, 3, 3] in mm², in single
    precision: uncertainties need no more.
    """

    point_mm: Float64[np.ndarray, "pixels 3"]
    distance_liquid_mm: Float64[np.ndarray, " pixels"]
    distance_air_mm: Float64[np.ndarray, " pixels"]
    gap_mm: Float64[np.ndarray, " pixels"]
    gap_sd_mm: Float64[np.ndarray, " pixels"]
    angle_rad: Float64[np.ndarray, " pixels"]
    angle_sd_rad: Float64[np.ndarray, " pixels"]
    covariance: Float32[np.ndarray, "pixels 3 3"]

    def some(self, pixels: np.ndarray | slice) -> "EntryPoints":
        """Return the crossings of some of the pixels."""
        return EntryPoints(*(getattr(self, name)[pixels] for name in EntryPoints.__slots__))


def entry_points(liquid: LightPaths, air: LightPaths, *, weighted: bool, threads: int = 1) -> EntryPoints:
    """Cross the two paths of each pixel.

    The paper takes the middle of the shortest segment between them; ``weighted`` divides that segment by the two
    paths' variances instead. Parallel paths give NaN. So many ``threads`` share the pixels.
    """
    count = len(liquid.direction)

    def room(*shape: int) -> np.ndarray:
        return np.empty((count, *shape))

    covariance = np.empty((count, 3, 3), np.float32)
    result = EntryPoints(room(3), room(), room(), room(), room(), room(), room(), covariance)
    noises = [noise for paths in (liquid, air) for noise in (paths.near_noise, paths.far_noise)]
    axes = np.stack([noise.axes for noise in noises])

    def cross(band: slice) -> None:
        wet, dry, found = liquid.some(band), air.some(band), result.some(band)
        _write_crossings(
            *(wet.near_mm, wet.direction, wet.baseline_mm, dry.near_mm, dry.direction, dry.baseline_mm),
            *(axes, wet.near_noise.sd_mm, wet.far_noise.sd_mm, dry.near_noise.sd_mm, dry.far_noise.sd_mm, weighted),
            *(found.point_mm, found.distance_liquid_mm, found.distance_air_mm, found.gap_mm, found.gap_sd_mm),
            *(found.angle_rad, found.angle_sd_rad, found.covariance),
        )

    over_bands(cross, count, threads=threads)
    return result


@compiled
def _write_crossings(
    near_liquid: np.ndarray,
    liquid: np.ndarray,
    baseline_liquid: np.ndarray,
    near_air: np.ndarray,
    air: np.ndarray,
    baseline_air: np.ndarray,
    axes: np.ndarray,
    near_liquid_sd: np.ndarray,
    far_liquid_sd: np.ndarray,
    near_air_sd: np.ndarray,
    far_air_sd: np.ndarray,
    weighted: bool,
    point: np.ndarray,
    distance_liquid: np.ndarray,
    distance_air: np.ndarray,
    gap: np.ndarray,
    gap_sd: np.ndarray,
    angle: np.ndarray,
    angle_sd: np.ndarray,
    covariance: np.ndarray,
) -> None:
    """Write the crossing of the paths P + sU in liquid and Q + tV in air of every pixel."""
    cross, common, across_liquid, across_air = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    told = np.empty((2, 4))
    for pixel in range(len(gap)):
        u, v = liquid[pixel], air[pixel]
        squared = facing = 0.0
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            cross[k] = u[a] * v[b] - u[b] * v[a]
            squared += cross[k] ** 2
            facing += u[k] * v[k]
        angle[pixel] = np.arctan2(np.sqrt(squared), facing)
        squared = squared if squared > PARALLEL else np.nan
        sine = np.sqrt(squared)
        s = t = apart = 0.0
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            common[k] = cross[k] / sine
            one, other = near_air[pixel, a] - near_liquid[pixel, a], near_air[pixel, b] - near_liquid[pixel, b]
            s += (one * v[b] - other * v[a]) * cross[k]
            t += (one * u[b] - other * u[a]) * cross[k]
            apart += (near_air[pixel, k] - near_liquid[pixel, k]) * common[k]
        s, t = s / squared, t / squared
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            across_liquid[k] = common[a] * u[b] - common[b] * u[a]
            across_air[k] = common[a] * v[b] - common[b] * v[a]
        lever_liquid, lever_air = s / baseline_liquid[pixel], t / baseline_air[pixel]
        _tell_noise(
            axes[0], axes[1], near_liquid_sd[pixel], far_liquid_sd[pixel], lever_liquid, across_liquid, common, told[0]
        )
        _tell_noise(axes[2], axes[3], near_air_sd[pixel], far_air_sd[pixel], lever_air, across_air, common, told[1])
        total = told[0, 2] + told[1, 2]
        share = (told[1, 2] / total if total > 0 else 0.5) if weighted else 0.5
        distance_liquid[pixel], distance_air[pixel], gap[pixel], gap_sd[pixel] = s, t, apart, np.sqrt(total)
        turned = told[0, 3] / baseline_liquid[pixel] ** 2 + told[1, 3] / baseline_air[pixel] ** 2
        angle_sd[pixel] = np.sqrt(turned)
        # Shifting line P + sU by d moves the crossing by V (d·(c×U))/sin + share c (c·d), and shifting the other one likewise.
        both_liquid, both_air = share * told[0, 1] / sine, -(1 - share) * told[1, 1] / sine
        alone = share**2 * told[0, 2] + (1 - share) ** 2 * told[1, 2]
        for k in range(3):
            here, there = near_liquid[pixel, k] + s * u[k], near_air[pixel, k] + t * v[k]
            point[pixel, k] = share * here + (1 - share) * there
            for j in range(3):
                covariance[pixel, k, j] = (
                    (told[0, 0] * v[k] * v[j] + told[1, 0] * u[k] * u[j]) / squared
                    + both_liquid * (v[k] * common[j] + common[k] * v[j])
                    + both_air * (u[k] * common[j] + common[k] * u[j])
                    + alone * common[k] * common[j]
                )


@compiled
def _tell_noise(
    near_axes: np.ndarray,
    far_axes: np.ndarray,
    near_sd: np.ndarray,
    far_sd: np.ndarray,
    lever: float,
    across: np.ndarray,
    common: np.ndarray,
    told: np.ndarray,
) -> None:
    """Write variances of a path's place at a lever: ``across``, with ``common``, along ``common``; and, without a lever, across.

    Each display point errs along two axes, independently. Terms of the order of gap times shift are left out.
    """
    told[:] = 0.0
    for j in range(2):
        near_across = near_common = far_across = far_common = 0.0
        for k in range(3):
            near_across += near_axes[k, j] * across[k]
            near_common += near_axes[k, j] * common[k]
            far_across += far_axes[k, j] * across[k]
            far_common += far_axes[k, j] * common[k]
        near, far = near_sd[j] ** 2, far_sd[j] ** 2
        told[3] += near * near_across**2 + far * far_across**2
        near, far = (1 + lever) ** 2 * near, lever**2 * far
        told[0] += near * near_across**2 + far * far_across**2
        told[1] += near * near_across * near_common + far * far_across * far_common
        told[2] += near * near_common**2 + far * far_common**2


def crossing_by_liquid(liquid: LightPaths, air: LightPaths, points: EntryPoints) -> Float64[np.ndarray, "pixels 3 3"]:
    """Return how each crossing moves when its path in liquid is shifted there: what a slipped display does to it.

    Terms of the order of gap times shift are left out, as in the covariance.
    """
    cross = np.cross(liquid.direction, air.direction)
    sine = np.linalg.norm(cross, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        common = cross / sine[:, None]
        variance_air = air.variance_along(common, points.distance_air_mm)
        share = _liquid_share(variance_air, points.gap_sd_mm**2)
        return _by_liquid(liquid.direction, air.direction, common, sine, share)


def _by_liquid(
    u: np.ndarray, v: np.ndarray, common: np.ndarray, sine: np.ndarray, share: np.ndarray
) -> Float64[np.ndarray, "pixels 3 3"]:
    """Shifting line P + sU by d moves the crossing by V (d·(c×U))/sin + share c (c·d)."""
    return _outer(v / sine[:, None], np.cross(common, u)) + share[:, None, None] * _outer(common, common)


def _liquid_share(variance_air: np.ndarray, total: np.ndarray) -> np.ndarray:
    return np.where(total > 0, variance_air / np.where(total > 0, total, 1.0), 0.5)


def _outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, :, None] * b[:, None, :]
