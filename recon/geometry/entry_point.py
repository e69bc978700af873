"""The first entry point (FEP): where a pixel's path in liquid and its path in air come closest.

Geometry of two skew lines P + sU and Q + tV. In their common directions the crossing is fixed by both lines; along
c = U×V/|U×V| each line says where it is, and the gap between them measures how well they agree.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from recon.geometry.light_paths import LightPaths

# sin² of the angle below which two lines have no crossing in double precision.
PARALLEL = 1e-18
PIXELS_AT_ONCE = 1 << 14


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
    """Cross the two paths of each pixel, some at a time: what is made on the way takes more memory than what comes out.

    The paper takes the middle of the shortest segment between them; ``weighted`` divides that segment by the two
    paths' variances instead. Parallel paths give NaN. So many ``threads`` share the pixels.
    """
    count = len(liquid.direction)
    if count <= PIXELS_AT_ONCE:
        return _entry_points(liquid, air, weighted=weighted)

    def room(*shape: int) -> np.ndarray:
        return np.empty((count, *shape))

    covariance = np.empty((count, 3, 3), np.float32)
    result = EntryPoints(room(3), room(), room(), room(), room(), room(), room(), covariance)

    def cross(low: int) -> None:
        rows = slice(low, low + PIXELS_AT_ONCE)
        part = _entry_points(liquid.some(rows), air.some(rows), weighted=weighted)
        for name in EntryPoints.__slots__:
            getattr(result, name)[rows] = getattr(part, name)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(cross, range(0, count, PIXELS_AT_ONCE)))
    return result


def _entry_points(liquid: LightPaths, air: LightPaths, *, weighted: bool) -> EntryPoints:
    u, v = liquid.direction, air.direction
    cross = np.cross(u, v)
    sine_squared = (cross**2).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        safe = np.where(sine_squared > PARALLEL, sine_squared, np.nan)
        sine = np.sqrt(safe)
        common = cross / sine[:, None]
        offset = air.near_mm - liquid.near_mm
        s = (np.cross(offset, v) * cross).sum(1) / safe
        t = (np.cross(offset, u) * cross).sum(1) / safe
    gap = (offset * common).sum(1)
    variance_liquid, variance_air = liquid.variance_along(common, s), air.variance_along(common, t)
    total = variance_liquid + variance_air
    share = _liquid_share(variance_air, total) if weighted else np.full_like(total, 0.5)
    point = share[:, None] * liquid.point_at(s) + (1 - share)[:, None] * air.point_at(t)
    return EntryPoints(
        point_mm=point,
        distance_liquid_mm=s,
        distance_air_mm=t,
        gap_mm=gap,
        gap_sd_mm=np.sqrt(total),
        angle_rad=np.arctan2(np.sqrt(sine_squared), (u * v).sum(1)),
        angle_sd_rad=_angle_sd(liquid, air, common),
        covariance=_covariance(liquid, air, (s, t), common, sine, share),
    )


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


def _angle_sd(liquid: LightPaths, air: LightPaths, common: np.ndarray) -> np.ndarray:
    """Return the sd of the angle: of each direction's part in the common plane, across the direction."""
    variance = np.zeros(len(common))
    for paths in (liquid, air):
        variance += paths.turn_variance_along(np.cross(common, paths.direction))
    return np.sqrt(variance)


def _covariance(
    liquid: LightPaths,
    air: LightPaths,
    distance_mm: tuple[np.ndarray, np.ndarray],
    common: np.ndarray,
    sine: np.ndarray,
    share: np.ndarray,
) -> np.ndarray:
    """Propagate a small shift of either line to the crossing, leaving out terms of the order of gap times shift.

    Each display point errs along two axes, independently: eight vectors move the crossing.
    """
    u, v = liquid.direction, air.direction
    moves = []
    for paths, distance, along, across, part in (
        (liquid, distance_mm[0], v / sine[:, None], np.cross(common, u), share),
        (air, distance_mm[1], -u / sine[:, None], np.cross(common, v), 1 - share),
    ):
        lever = distance / paths.baseline_mm
        for noise, weight in ((paths.near_noise, 1 + lever), (paths.far_noise, lever)):
            for axis, sd in zip(noise.axes.T, noise.sd_mm.T, strict=True):
                size = weight * sd
                moves.append(
                    (size * (across @ axis))[:, None] * along + (size * part * (common @ axis))[:, None] * common
                )
    stacked = np.stack(moves, axis=2)
    return np.einsum("pik,pjk->pij", stacked, stacked).astype(np.float32)


def _outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, :, None] * b[:, None, :]
