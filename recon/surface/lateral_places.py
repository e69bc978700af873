"""Where each pixel looks, across the mean line of sight: smoothed as far as the paths' own noise explains the residuals."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float16, Float64
from scipy.special import chdtri

from recon.surface.ray_chords import Mask, ScalarMap, VectorMap
from recon.surface.tiles import Part, inside, tiles
from recon.surface.window_quadratic import Lines, fit_windows

# Half-widths of the windows that are tried, each only where the one before it held.
HALF_WIDTHS_PX = (2, 4)
# One in a thousand smooth windows is turned down for its noise.
REJECTED_SHARE = 1e-3
# No lateral place counts as more than this many times surer than the typical one: an sd may be too good to be true.
SUREST = 20.0
# What is made of so many pixels is small beside the maps of an object.
PIXELS_AT_ONCE = 1 << 15


@dataclass(frozen=True, slots=True, eq=False)
class LateralPlaces:
    """Places across the mean line of sight, their variances, and the three axes (the last along the sight).

    ``error_mm`` is what draws of the paths' noise do to the places.
    """

    place_mm: Float64[np.ndarray, "2 rows cols"]
    variance: Float64[np.ndarray, "2 rows cols"]
    error_mm: Float16[np.ndarray, "2 draws rows cols"]
    axes: Float64[np.ndarray, "3 3"]


def lateral_places(
    point_mm: VectorMap,
    shift: Float64[np.ndarray, "pixels 3 3"],
    used: Mask,
    slide_mm: Float16[np.ndarray, "2 draws rows cols"],
    axes: Float64[np.ndarray, "3 3"],
    *,
    threads: int = 1,
) -> LateralPlaces:
    """Smooth the places across the mean line of sight, over windows whose residuals are those of the paths' noise.

    ``shift`` is the covariance of where each used pixel's path meets the surface. ``slide_mm`` are draws of how far it meets it
    from where it should, along the first two of the ``axes``; the third is the mean line of sight. So many ``threads`` go through
    the tiles.
    """
    measured = np.moveaxis(np.nan_to_num(point_mm) @ axes[:2].T, -1, 0)
    variance = np.full((2, *used.shape), np.nan)
    for axis in (0, 1):
        own = np.einsum("i,pij,j->p", axes[axis], shift, axes[axis])
        variance[axis][used] = np.maximum(own, np.median(own) / SUREST**2)
    weight = np.where(used & (variance > 0), 1 / np.where(variance > 0, variance, 1.0), 0.0)
    place, left = np.where(used, measured, np.nan), variance.copy()
    error = slide_mm.copy()

    def smooth(tile: tuple[Part, Part]) -> None:
        core, wide = tile
        inner = inside(core, wide)
        rows, columns = _grid(wide)
        lines = Lines.upright(columns, rows)
        for axis in (0, 1):
            here, values = weight[axis][wide], measured[axis][wide]
            if not here.any():
                continue
            centred = np.where(here > 0, values - np.average(values, weights=here), 0.0)
            middle = values - centred
            held = here > 0
            noise = slide_mm[(axis, slice(None), *wide)].astype(np.float32)
            fits = fit_windows(columns, rows, centred, noise, here, lines, half_widths=HALF_WIDTHS_PX, readings=1)
            for half_width, fit in zip(HALF_WIDTHS_PX, fits, strict=True):
                freedom = fit.count - 6
                held &= (freedom >= 3) & (
                    fit.misfit < _largest_misfit(half_width)[np.maximum(freedom, 1).astype(np.int64)]
                )
                spread = fit.variance[0][inner]
                better = held[inner] & (spread < left[axis][core])
                np.copyto(place[axis][core], (fit.along + middle)[inner], where=better)
                np.copyto(error[(axis, slice(None), *core)], fit.drawn[(0, slice(None), *inner)], where=better)
                np.copyto(left[axis][core], spread, where=better)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(smooth, tiles(used, border=max(HALF_WIDTHS_PX))))
    return LateralPlaces(place, left, error, axes)


@cache
def _largest_misfit(half_width: int) -> Float64[np.ndarray, " freedoms"]:
    """Return the largest misfit of a smooth window, by its degrees of freedom, of which 0 is none."""
    return np.concatenate([[0.0], chdtri(np.arange(1, (2 * half_width + 1) ** 2 + 1), REJECTED_SHARE)])


def along_surface(
    covariance: Float64[np.ndarray, "pixels 3 3"],
    direction: Float64[np.ndarray, "pixels 3"],
    normal: Float64[np.ndarray, "pixels 3"],
) -> Float64[np.ndarray, "pixels 3 3"]:
    """Return the covariance of where a path meets the surface: a shift d moves it by d − V (n·d)/(n·V)."""
    result = np.empty_like(covariance)
    for low in range(0, len(result), PIXELS_AT_ONCE):
        part = slice(low, low + PIXELS_AT_ONCE)
        path, upward, moved = direction[part], normal[part], covariance[part]
        facing = (path * upward).sum(axis=1)
        facing = np.where(np.abs(facing) > 1e-3, facing, 1e-3)[:, None]
        # (1 − V nᵀ/f) C (1 − n Vᵀ/f) = C − V wᵀ − w Vᵀ, where w = C n/f − V (nᵀ C n)/2f².
        share = np.einsum("pij,pj->pi", moved, upward) / facing
        share -= path * (share * upward).sum(axis=1, keepdims=True) / (2 * facing)
        both = path[:, :, None] * share[:, None, :]
        result[part] = moved - both - np.swapaxes(both, 1, 2)
    return result


def _grid(wide: tuple[slice, slice]) -> tuple[ScalarMap, ScalarMap]:
    """Return rows and columns of a tile about its middle, in units of a window."""
    rows, columns = np.indices([part.stop - part.start for part in wide]).astype(np.float64)
    return (rows - rows.mean()) / 4, (columns - columns.mean()) / 4


def frame_along(along: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, "3 3"]:
    """Return a frame as rows, the last of them ``along``."""
    helper = np.eye(3)[np.argmin(np.abs(along))]
    first = np.cross(helper, along)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(along, first), along])
