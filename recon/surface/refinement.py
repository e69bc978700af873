"""Points and normals refined from the fused surface, as far as the data themselves allow, with their uncertainty.

The fused points lie on the surface but slide along it with the noise of their light paths. First each pixel's lateral place
is taken from a quadratic polynomial over the pixels about it; then the surface's height, over the places where the measured
paths meet it, gives point and normal there. A window is used only where its residuals are what noise alone would leave:
creases, steps and ripples stay.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from recon.surface.fusion import FusedSurface
from recon.surface.height_patch import Patch, Sight, against_own_normals, beyond_noise, patch_of, within_noise
from recon.surface.lateral_places import LateralPlaces, along_surface, frame_along, lateral_places
from recon.surface.noise_reference import NoiseReference, Shares, depth_class, depth_of, steadied, straight_depth_of
from recon.surface.patch_loops import take_over
from recon.surface.ray_chords import Mask, ScalarMap, VectorMap
from recon.surface.tiles import TILE_PX, Part, inside, tiles
from recon.surface.window_bias import own_slopes
from recon.surface.window_quadratic import fit_windows

# Half-widths of the windows that are tried, each only where the one before it held.
HALF_WIDTHS_PX = (1, 2, 4)
WIDEST_HALF_WIDTH_PX = max(HALF_WIDTHS_PX)
# Normals farther than this from their tile's mean are too steep for a height above it.
STEEPEST_COSINE = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class RefinedSurface:
    """Points and normals of the surface; NaN where the fused surface has none.

    ``sd_mm`` is the root of the summed variances of the point, ``across_sd_mm`` its part across the surface,
    ``normal_sd_rad`` the root of the summed variances of the two tilts. ``half_width_px`` tells from how many neighbours the
    normal comes (0: it is the pixel's own measurement).
    """

    point_mm: VectorMap
    normal: VectorMap
    sd_mm: ScalarMap
    across_sd_mm: ScalarMap
    normal_sd_rad: ScalarMap
    half_width_px: UInt8[np.ndarray, "rows cols"]


def refine_surface(
    fused: FusedSurface,
    direction: VectorMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
    path_covariance: Float64[np.ndarray, "rows cols 3 3"],
    *,
    threads: int = 1,
) -> RefinedSurface:
    """Refine a fused surface.

    Parameters
    ----------
    fused
        The surface on its light paths.
    direction, normal, normal_sd_rad
        What was fused.
    path_covariance
        Covariance of a shift of each light path at its point, in mm².
    threads
        How many tiles are refined at a time; the result is the same.
    """
    used = np.isfinite(fused.point_mm).all(axis=2)
    shift = along_surface(path_covariance[used], direction[used], normal[used])
    del path_covariance  # nobody else holds it, and the places below need that room
    result = _own_measurement(fused, direction, normal, normal_sd_rad, shift, used)
    if not used.any():
        return result
    lateral = lateral_places(fused.point_mm, shift, used, fused.slide_mm, fused.sight_frame, threads=threads)
    del shift
    depth_px, straight_px = depth_of(used), straight_depth_of(used)

    left_rad2 = np.zeros(used.shape, np.float32)

    def refine(tile: tuple[Part, Part]) -> Shares | None:
        return _refine_tile(
            result, left_rad2, fused, direction, normal, normal_sd_rad, lateral, used, depth_px, straight_px, *tile
        )

    parts = list(tiles(used, border=WIDEST_HALF_WIDTH_PX))
    with ThreadPoolExecutor(threads) as pool:
        told = list(pool.map(refine, parts))
    cores = {(core[0].start // TILE_PX, core[1].start // TILE_PX): core for core, _ in parts}
    shares = {place: each for place, each in zip(cores, told, strict=True) if each is not None}
    for place, larger in steadied(shares).items():
        _scale_noise(result, left_rad2, depth_px, larger, cores[place])
    return result


def _scale_noise(
    result: RefinedSurface,
    left_rad2: Float32[np.ndarray, "rows cols"],
    depth_px: ScalarMap,
    larger: Float64[np.ndarray, "windows depths"],
    core: tuple[slice, slice],
) -> None:
    """Make the noise's part of windows' variances in a tile so much larger; ``left_rad2`` of their bias stays."""
    half_width, sd = result.half_width_px[core], result.normal_sd_rad[core]
    factor = larger[np.searchsorted(HALF_WIDTHS_PX, half_width), depth_class(depth_px[core])]
    left = left_rad2[core].astype(np.float64)
    scaled = np.sqrt(np.maximum(sd**2 - left, 0.0) * factor + left)
    np.copyto(sd, scaled, where=half_width > 0)


def _own_measurement(
    fused: FusedSurface,
    direction: VectorMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
    shift: Float64[np.ndarray, "pixels 3 3"],
    used: Mask,
) -> RefinedSurface:
    """Return the surface as it is before any neighbour is asked."""
    across = np.abs((direction * normal).sum(axis=2)) * fused.distance_sd_mm
    sd = np.full(used.shape, np.nan)
    sd[used] = np.sqrt(np.trace(shift, axis1=1, axis2=2) + fused.distance_sd_mm[used] ** 2)
    return RefinedSurface(
        point_mm=fused.point_mm.copy(),
        normal=np.where(used[..., None], normal, np.nan),
        sd_mm=sd,
        across_sd_mm=np.where(used, across, np.nan),
        normal_sd_rad=np.where(used, normal_sd_rad, np.nan),
        half_width_px=np.zeros(used.shape, np.uint8),
    )


def _refine_tile(
    result: RefinedSurface,
    left_rad2: Float32[np.ndarray, "all_rows all_cols"],
    fused: FusedSurface,
    direction: VectorMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
    lateral: LateralPlaces,
    used: Mask,
    depth_px: ScalarMap,
    straight_px: ScalarMap,
    core: tuple[slice, slice],
    wide: tuple[slice, slice],
) -> Shares | None:
    """Fit heights over the plane that suits a tile, and write what they say into the result's maps.

    Returned is what the windows' draws told of their noise, if any were fitted.
    """
    mean = normal[wide][used[wide]].mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), np.finfo(float).tiny)
    frame = frame_along(mean)
    cosine = np.nan_to_num(normal[wide]) @ mean
    fit_here = used[wide] & (cosine > STEEPEST_COSINE)
    if not fit_here[inside(core, wide)].any():
        return None
    middle = fused.point_mm[wide][fit_here].mean(axis=0)
    unit_mm = 4 * _spacing_mm(fused.point_mm[wide], fit_here)
    local = np.where(fit_here[..., None], (fused.point_mm[wide] - middle) @ frame.T / unit_mm, 0.0)
    # An error of the distance lifts the surface along its normal; over the tile's plane it is that much higher.
    lift = (direction[wide] * normal[wide]).sum(axis=2) / np.where(fit_here, cosine, 1.0)
    errors = np.where(
        fit_here, fused.distance_error_mm[(slice(None), *wide)] * (lift / unit_mm).astype(np.float32), 0.0
    )
    weight = fit_here.astype(np.float64)
    place = Sight.of(lateral, wide, middle_mm=middle, unit_mm=unit_mm, frame=frame)
    within = np.zeros(fit_here.shape, dtype=bool)
    within[inside(core, wide)] = True
    noise = NoiseReference(np.where(fit_here, fused.turn_sd_rad[wide], 1.0), depth_px[wide], within)
    held, trust = fit_here.copy(), weight
    tilted = normal[wide] @ frame.T
    own_turn = np.tensordot(frame.astype(np.float32), fused.own_turn_rad[(..., *wide)].astype(np.float32), axes=1)
    before = own_slopes(tilted, own_turn, fit_here)
    p, q, height = np.moveaxis(local, -1, 0)
    fits = fit_windows(p, q, height, errors, weight, place.lines, half_widths=HALF_WIDTHS_PX, readings=3)
    for (smaller, half_width), fit in zip(pairwise((0, *HALF_WIDTHS_PX)), fits, strict=True):
        beyond = beyond_noise(fit, fit_here)
        held &= within_noise(beyond)
        trust = np.minimum(trust, np.nan_to_num(np.maximum(beyond, 1.0) ** -2.0))
        patch, before = patch_of(
            fit, place, fit_here, before, trust, noise, straight_px[wide], half_width=half_width, smaller=smaller
        )
        held &= ~against_own_normals(patch.normal, tilted, normal_sd_rad[wide] * fused.normal_scale)
        _take_over(result, left_rad2, patch, held, core, wide, half_width, place)
    return np.stack(noise.told)


def _take_over(
    result: RefinedSurface,
    left_rad2: Float32[np.ndarray, "all_rows all_cols"],
    patch: Patch,
    held: Mask,
    core: tuple[slice, slice],
    wide: tuple[slice, slice],
    half_width: int,
    place: Sight,
) -> None:
    """Write a patch's normals where its window held and makes them surer, and its points likewise.

    A pixel's own normal may be surer than that of a window whose points are surer than its own.
    """
    inner = inside(core, wide)
    take_over(
        held[inner],
        patch.point[inner],
        patch.normal[inner],
        patch.sd[inner],
        patch.across_sd[inner],
        patch.normal_sd[inner],
        patch.left_squared[inner],
        place.frame,
        place.middle_mm,
        place.unit_mm,
        half_width,
        (core[0].start, core[1].start),
        result.point_mm,
        result.normal,
        result.sd_mm,
        result.across_sd_mm,
        result.normal_sd_rad,
        left_rad2,
        result.half_width_px,
    )


def _spacing_mm(point_mm: VectorMap, mask: Mask) -> float:
    """Return the typical distance between neighbours."""
    steps = np.linalg.norm(np.diff(point_mm, axis=1), axis=2)[mask[:, 1:] & mask[:, :-1]]
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1.0
