"""Points and normals refined from the fused surface, as far as the data themselves allow, with their uncertainty.

The fused points lie on the surface but slide along it with the noise of their light paths. First each pixel's lateral place
is taken from a quadratic polynomial over the pixels about it; then the surface's height, over the places where the measured
paths meet it, gives point and normal there. A window is used only where its residuals are what noise alone would leave:
creases, steps and ripples stay.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, UInt8
from scipy.stats import chi2

from recon.surface.fusion import FusedSurface, standard_deviation
from recon.surface.ray_chords import Mask, ScalarMap, VectorMap
from recon.surface.tiles import inside, tiles
from recon.surface.window_quadratic import WindowFit, fit_windows

# Half-widths of the windows that are tried, each only where the one before it held.
LATERAL_HALF_WIDTHS_PX = (2, 4)
HEIGHT_HALF_WIDTHS_PX = (1, 2, 4)
# One in a thousand smooth windows is turned down for its noise.
REJECTED_SHARE = 1e-3
# Residuals of the fused surface are those of neighbours that share their normals: they count half.
INDEPENDENT_SHARE = 0.5
# No lateral place counts as more than this many times surer than the typical one: an sd may be too good to be true.
SUREST = 20.0
# The bias of a window is taken from this many pixels across.
BIAS_WINDOW_PX = 9
WIDEST_HALF_WIDTH_PX = max(*LATERAL_HALF_WIDTHS_PX, *HEIGHT_HALF_WIDTHS_PX)
# Normals farther than this from their tile's mean are too steep for a height above it.
STEEPEST_COSINE = 0.35
NEWTON_STEPS = 4


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


@dataclass(frozen=True, slots=True, eq=False)
class _Lateral:
    """Places across the mean line of sight [2, rows, cols], their variances, and the three axes (the last along the sight)."""

    place_mm: Float64[np.ndarray, "2 rows cols"]
    variance: Float64[np.ndarray, "2 rows cols"]
    axes: Float64[np.ndarray, "3 3"]


def refine_surface(
    fused: FusedSurface,
    direction: VectorMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
    path_covariance: Float64[np.ndarray, "rows cols 3 3"],
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
    """
    used = np.isfinite(fused.point_mm).all(axis=2)
    result = _own_measurement(fused, direction, normal, normal_sd_rad, path_covariance, used)
    if not used.any():
        return result
    lateral = _lateral_places(fused.point_mm, direction, normal, path_covariance, used)
    for core, wide in tiles(used, border=WIDEST_HALF_WIDTH_PX):
        _refine_tile(result, fused, direction, normal, lateral, used, core, wide)
    return result


def _own_measurement(
    fused: FusedSurface,
    direction: VectorMap,
    normal: VectorMap,
    normal_sd_rad: ScalarMap,
    path_covariance: Float64[np.ndarray, "rows cols 3 3"],
    used: Mask,
) -> RefinedSurface:
    """Return the surface as it is before any neighbour is asked."""
    shift = _along_surface(path_covariance[used], direction[used], normal[used])
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


def _along_surface(
    covariance: Float64[np.ndarray, "pixels 3 3"],
    direction: Float64[np.ndarray, "pixels 3"],
    normal: Float64[np.ndarray, "pixels 3"],
) -> Float64[np.ndarray, "pixels 3 3"]:
    """Return the covariance of where a path meets the surface: a shift d moves it by d − V (n·d)/(n·V)."""
    facing = (direction * normal).sum(axis=1)
    facing = np.where(np.abs(facing) > 1e-3, facing, 1e-3)
    slide = np.eye(3) - direction[:, :, None] * (normal / facing[:, None])[:, None, :]
    return slide @ covariance @ np.swapaxes(slide, 1, 2)


def _lateral_places(
    point_mm: VectorMap,
    direction: VectorMap,
    normal: VectorMap,
    path_covariance: Float64[np.ndarray, "rows cols 3 3"],
    used: Mask,
) -> _Lateral:
    """Smooth the places across the mean line of sight, over windows whose residuals are those of the paths' noise."""
    sight = direction[used].mean(axis=0)
    axes = _axes(sight / np.linalg.norm(sight))
    shift = _along_surface(path_covariance[used], direction[used], normal[used])
    measured = np.moveaxis(np.nan_to_num(point_mm) @ axes[:2].T, -1, 0)
    variance = np.full((2, *used.shape), np.nan)
    for axis in (0, 1):
        own = np.einsum("i,pij,j->p", axes[axis], shift, axes[axis])
        variance[axis][used] = np.maximum(own, np.median(own) / SUREST**2)
    weight = np.where(used & (variance > 0), 1 / np.where(variance > 0, variance, 1.0), 0.0)
    place, left = np.where(used, measured, np.nan), variance.copy()
    for core, wide in tiles(used, border=WIDEST_HALF_WIDTH_PX):
        inner = inside(core, wide)
        rows, columns = _grid(wide)
        for axis in (0, 1):
            here, values = weight[axis][wide], measured[axis][wide]
            if not here.any():
                continue
            centred = np.where(here > 0, values - np.average(values, weights=here), 0.0)
            middle = values - centred
            held = here > 0
            for half_width in LATERAL_HALF_WIDTHS_PX:
                fit = fit_windows(columns, rows, centred[None], here, half_width=half_width)
                freedom = fit.count - 6
                held &= (freedom >= 3) & (fit.misfit[0] < chi2.isf(REJECTED_SHARE, np.maximum(freedom, 1)))
                found = (fit.value(columns, rows)[0] + middle)[inner]
                spread = fit.value_variance(columns, rows)[inner]
                better = held[inner] & (spread < left[axis][core])
                place[axis][core] = np.where(better, found, place[axis][core])
                left[axis][core] = np.where(better, spread, left[axis][core])
    return _Lateral(place, left, axes)


def _refine_tile(
    result: RefinedSurface,
    fused: FusedSurface,
    direction: VectorMap,
    normal: VectorMap,
    lateral: _Lateral,
    used: Mask,
    core: tuple[slice, slice],
    wide: tuple[slice, slice],
) -> None:
    """Fit heights over the plane that suits a tile, and write what they say into the result's maps."""
    mean = normal[wide][used[wide]].mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), np.finfo(float).tiny)
    frame = _axes(mean)
    cosine = np.nan_to_num(normal[wide]) @ mean
    fit_here = used[wide] & (cosine > STEEPEST_COSINE)
    if not fit_here[inside(core, wide)].any():
        return
    middle = fused.point_mm[wide][fit_here].mean(axis=0)
    unit_mm = 4 * _spacing_mm(fused.point_mm[wide], fit_here)
    local = np.where(fit_here[..., None], (fused.point_mm[wide] - middle) @ frame.T / unit_mm, 0.0)
    # An error of the distance lifts the surface along its normal; over the tile's plane it is that much higher.
    lift = (direction[wide] * normal[wide]).sum(axis=2) / np.where(fit_here, cosine, 1.0)
    errors = np.where(fit_here, fused.distance_error_mm[(slice(None), *wide)] * lift / unit_mm, 0.0)
    fields = np.concatenate([local[None, ..., 2], errors])
    weight = fit_here.astype(np.float64)
    place = _Place.of(lateral, wide, middle_mm=middle, unit_mm=unit_mm, frame=frame)
    held = fit_here.copy()
    before = _own_slopes(normal[wide] @ frame.T, fit_here, draws=len(errors))
    for half_width in HEIGHT_HALF_WIDTHS_PX:
        fit = fit_windows(local[..., 0], local[..., 1], fields, weight, half_width=half_width)
        held &= _like_noise(fit, fit_here)
        patch, before = _patch(fit, place, fit_here, before)
        _take_over(result, patch, held, core, wide, half_width, place)


def _own_slopes(normal: VectorMap, mask: Mask, *, draws: int) -> Float64[np.ndarray, "2 fields rows cols"]:
    """Return the slopes that the measured normals tell, with no draws of their noise."""
    slopes = np.zeros((2, draws + 1, *mask.shape))
    up = np.where(mask, normal[..., 2], 1.0)
    for axis in (0, 1):
        slopes[axis, 0] = np.where(mask, -normal[..., axis] / up, 0.0)
    return slopes


def _like_noise(fit: WindowFit, mask: Mask) -> Mask:
    """Tell where the heights leave no more than their own noise does, which the draws show."""
    freedom = INDEPENDENT_SHARE * np.maximum(fit.count - 6, 1)
    expected = standard_deviation(np.sqrt(fit.misfit[1:]), mask) ** 2
    largest = chi2.isf(REJECTED_SHARE, freedom) / freedom
    with np.errstate(invalid="ignore"):
        return (fit.count >= 8) & (fit.misfit[0] <= largest * expected)


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Where a tile's pixels look: a line along the sight through each lateral place, in the tile's own frame and unit."""

    start: Float64[np.ndarray, "rows cols 3"]
    sight: Float64[np.ndarray, " 3"]
    across: Float64[np.ndarray, "2 3"]
    variance: Float64[np.ndarray, "2 rows cols"]
    middle_mm: Float64[np.ndarray, " 3"]
    unit_mm: float
    frame: Float64[np.ndarray, "3 3"]

    @classmethod
    def of(
        cls,
        lateral: _Lateral,
        wide: tuple[slice, slice],
        *,
        middle_mm: np.ndarray,
        unit_mm: float,
        frame: np.ndarray,
    ) -> "_Place":
        place = np.nan_to_num(lateral.place_mm[(slice(None), *wide)])
        # From the tile's own middle, so that Newton starts near the surface.
        offset = np.moveaxis(place, 0, -1) - lateral.axes[:2] @ middle_mm
        return cls(
            start=offset @ lateral.axes[:2] @ frame.T / unit_mm,
            sight=frame @ lateral.axes[2],
            across=lateral.axes[:2] @ frame.T,
            variance=lateral.variance[(slice(None), *wide)] / unit_mm**2,
            middle_mm=middle_mm,
            unit_mm=unit_mm,
            frame=frame,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Patch:
    """A tile's points and normals in its own frame and unit, with their standard deviations."""

    point: Float64[np.ndarray, "rows cols 3"]
    normal: Float64[np.ndarray, "rows cols 3"]
    sd: ScalarMap
    across_sd: ScalarMap
    normal_sd: ScalarMap


def _patch(
    fit: WindowFit, place: _Place, mask: Mask, before: Float64[np.ndarray, "2 fields rows cols"]
) -> tuple[_Patch, Float64[np.ndarray, "2 fields rows cols"]]:
    """Let each pixel's line of sight meet its polynomial, and carry the draws and the lateral place's sd along.

    ``before`` are the slopes of the next smaller window; those of this one are returned for the next larger.
    """
    sight = place.sight
    along = np.zeros(mask.shape)
    for _ in range(NEWTON_STEPS):
        point = place.start + along[..., None] * sight
        height = fit.value(point[..., 0], point[..., 1])
        slopes = fit.slopes(point[..., 0], point[..., 1])
        rate = sight[2] - slopes[0][0] * sight[0] - slopes[1][0] * sight[1]
        rate = np.where(np.abs(rate) > 1e-3, rate, np.copysign(1e-3, rate))
        along = along + (height[0] - point[..., 2]) / rate
    point = place.start + along[..., None] * sight
    upward = np.stack([-slopes[0][0], -slopes[1][0], np.ones(mask.shape)], axis=-1)
    length = np.linalg.norm(upward, axis=-1)
    normal = upward / length[..., None]
    facing = normal @ sight
    facing = np.where(np.abs(facing) > 1e-3, facing, 1e-3)
    # How the point and the normal move when the lateral place does.
    moves = [axis - (normal @ axis / facing)[..., None] * sight for axis in place.across]
    twice = fit.coefficients[0]
    turn_variance, slide_variance = np.zeros(mask.shape), np.zeros(mask.shape)
    for move, variance in zip(moves, place.variance, strict=True):
        slide_variance += variance * (move**2).sum(axis=-1)
        bend_p = 2 * twice[3] * move[..., 0] + twice[4] * move[..., 1]
        bend_q = twice[4] * move[..., 0] + 2 * twice[5] * move[..., 1]
        turn_variance += variance * _tilt_squared(bend_p, bend_q, normal, length)
    tilts = np.sqrt(_tilt_squared(slopes[0][1:], slopes[1][1:], normal, length))
    lifted = standard_deviation(height[1:], mask) / length
    now = np.stack(slopes)
    bias_squared = _bias_squared(now - before, mask, normal, length)
    patch = _Patch(
        point=point,
        normal=normal,
        sd=np.sqrt(slide_variance + (lifted / facing) ** 2),
        across_sd=lifted,
        normal_sd=np.sqrt(turn_variance + standard_deviation(tilts, mask) ** 2 + bias_squared),
    )
    return patch, now


def _bias_squared(
    change: Float64[np.ndarray, "2 fields rows cols"], mask: Mask, normal: np.ndarray, length: np.ndarray
) -> ScalarMap:
    """Return the squared tilt by which a larger window differs from a smaller one on the mean of many pixels.

    What noise alone makes of that mean, as the draws show, is taken off. The rest is what a quadratic polynomial cannot
    follow.
    """
    window = (BIAS_WINDOW_PX, BIAS_WINDOW_PX)
    count = cv2.boxFilter(mask.astype(np.float64), cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    held = np.where(mask, np.clip(np.nan_to_num(change), -1e3, 1e3), 0.0)
    flat = np.ascontiguousarray(np.moveaxis(held.reshape(-1, *mask.shape), 0, -1))
    total = cv2.boxFilter(flat, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    mean = np.moveaxis(total, -1, 0).reshape(change.shape) / np.maximum(count, 1.0)
    seen = _tilt_squared(mean[0, 0], mean[1, 0], normal, length)
    noise = _tilt_squared(mean[0, 1:], mean[1, 1:], normal, length).mean(axis=0)
    return np.maximum(seen - noise, 0.0)


def _tilt_squared(slope_p: np.ndarray, slope_q: np.ndarray, normal: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return the squared angle by which a change of the slopes turns the normal."""
    along = slope_p * normal[..., 0] + slope_q * normal[..., 1]
    return np.maximum(slope_p**2 + slope_q**2 - along**2, 0.0) / length**2


def _take_over(
    result: RefinedSurface,
    patch: _Patch,
    held: Mask,
    core: tuple[slice, slice],
    wide: tuple[slice, slice],
    half_width: int,
    place: _Place,
) -> None:
    """Write a patch where its window held and makes the normal surer."""
    inner = inside(core, wide)
    with np.errstate(invalid="ignore"):
        better = held[inner] & (patch.normal_sd[inner] < result.normal_sd_rad[core])
    point = place.middle_mm + place.unit_mm * patch.point[inner] @ place.frame
    unit = place.unit_mm
    for target, found in (
        (result.point_mm, point),
        (result.normal, patch.normal[inner] @ place.frame),
        (result.sd_mm, unit * patch.sd[inner]),
        (result.across_sd_mm, unit * patch.across_sd[inner]),
        (result.normal_sd_rad, patch.normal_sd[inner]),
        (result.half_width_px, np.full(better.shape, half_width, np.uint8)),
    ):
        target[core][better] = found[better]


def _grid(wide: tuple[slice, slice]) -> tuple[ScalarMap, ScalarMap]:
    """Return rows and columns of a tile about its middle, in units of a window."""
    rows, columns = np.indices([part.stop - part.start for part in wide]).astype(np.float64)
    return (rows - rows.mean()) / 4, (columns - columns.mean()) / 4


def _axes(along: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, "3 3"]:
    """Return a frame as rows, the last of them ``along``."""
    helper = np.eye(3)[np.argmin(np.abs(along))]
    first = np.cross(helper, along)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(along, first), along])


def _spacing_mm(point_mm: VectorMap, mask: Mask) -> float:
    """Return the typical distance between neighbours."""
    steps = np.linalg.norm(np.diff(point_mm, axis=1), axis=2)[mask[:, 1:] & mask[:, :-1]]
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1.0
