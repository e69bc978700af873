"""A tile's surface as heights over its own plane: a polynomial about every pixel, and where the pixel's sight meets it."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from jaxtyping import Float64
from scipy.stats import chi2

from recon.surface.fusion import standard_deviation
from recon.surface.lateral_places import LateralPlaces
from recon.surface.ray_chords import Mask, ScalarMap, VectorMap
from recon.surface.window_quadratic import WindowFit

Slopes = Float64[np.ndarray, "2 rows cols"]

# One in a thousand smooth windows is turned down for its noise.
REJECTED_SHARE = 1e-3
# Residuals of the fused surface are those of neighbours that share their normals: they count half.
INDEPENDENT_SHARE = 0.5
# The bias of a window is taken from this many pixels across.
BIAS_WINDOW_PX = 17
# The tilts of a window nine pixels wide are alike over it, so that more of them are needed for their variance.
TILT_WINDOW_PX = 17
NEWTON_STEPS = 4
LARGEST_SQUARE = float(chi2.isf(REJECTED_SHARE, 1))
# A window three pixels wide bends through a crease without a residual, but not without turning three of nine normals.
CREASE_SHARE = 1 / 3 - 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
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
        lateral: LateralPlaces,
        wide: tuple[slice, slice],
        *,
        middle_mm: np.ndarray,
        unit_mm: float,
        frame: np.ndarray,
    ) -> "Sight":
        """Look through the lateral places of a widened tile."""
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
class Patch:
    """A tile's points and normals in its own frame and unit, with their standard deviations."""

    point: Float64[np.ndarray, "rows cols 3"]
    normal: Float64[np.ndarray, "rows cols 3"]
    sd: ScalarMap
    across_sd: ScalarMap
    normal_sd: ScalarMap


def patch_of(
    fit: WindowFit,
    place: Sight,
    mask: Mask,
    before: Slopes,
    *,
    whole_bias: float,
) -> tuple[Patch, Slopes]:
    """Let each pixel's line of sight meet its polynomial, and carry the draws and the lateral place's sd along.

    ``before`` are the slopes of the next smaller window; those of this one are returned for the next larger. The bias
    is ``whole_bias`` times their difference.
    """
    sight = place.sight
    along = np.zeros(mask.shape)
    for _ in range(NEWTON_STEPS):
        point = place.start + along[..., None] * sight
        height = fit.value(point[..., 0], point[..., 1])
        slopes = fit.slopes(point[..., 0], point[..., 1])
        rate = sight[2] - slopes[0] * sight[0] - slopes[1] * sight[1]
        rate = np.where(np.abs(rate) > 1e-3, rate, np.copysign(1e-3, rate))
        along = along + (height - point[..., 2]) / rate
    point = place.start + along[..., None] * sight
    upward = np.stack([-slopes[0], -slopes[1], np.ones(mask.shape)], axis=-1)
    length = np.linalg.norm(upward, axis=-1)
    normal = upward / length[..., None]
    facing = normal @ sight
    facing = np.where(np.abs(facing) > 1e-3, facing, 1e-3)
    # How the point and the normal move when the lateral place does.
    moves = [axis - (normal @ axis / facing)[..., None] * sight for axis in place.across]
    twice = fit.coefficients
    turn_variance, slide_variance = np.zeros(mask.shape), np.zeros(mask.shape)
    for move, variance in zip(moves, place.variance, strict=True):
        slide_variance += variance * (move**2).sum(axis=-1)
        bend_p = 2 * twice[3] * move[..., 0] + twice[4] * move[..., 1]
        bend_q = twice[4] * move[..., 0] + 2 * twice[5] * move[..., 1]
        turn_variance += variance * _tilt_squared(bend_p, bend_q, normal, length)
    # A window at a rim is less sure of its slopes than one inside: what is alike is the noise, in units of that.
    slope_p, slope_q, slope_variance = fit.drawn_slopes(point[..., 0], point[..., 1])
    geometry = np.sqrt(slope_variance)
    tilts = np.sqrt(_tilt_squared(slope_p, slope_q, normal, length)) / geometry
    lifted = standard_deviation(fit.drawn_values(point[..., 0], point[..., 1]), mask) / length
    now = np.stack(slopes)
    bias_squared = whole_bias**2 * _bias_squared(now - before, mask, normal, length)
    noise_squared = turn_variance + (geometry * standard_deviation(tilts, mask, window_px=TILT_WINDOW_PX)) ** 2
    patch = Patch(
        point=point,
        normal=normal,
        sd=np.sqrt(slide_variance + (lifted / facing) ** 2),
        across_sd=lifted,
        normal_sd=np.sqrt(noise_squared + bias_squared),
    )
    return patch, now


def whole_bias(half_width: int, smaller: int) -> float:
    """Return a window's bias over what it differs by from that of a smaller window (0: the pixel's own normal, without bias).

    A cubic term c p³ gives the slope of the best quadratic polynomial over −h … h the bias c Σp⁴/Σp² = c (3h² + 3h − 1)/5.
    """
    bias = (3 * half_width**2 + 3 * half_width - 1) / 5
    return bias / (bias - ((3 * smaller**2 + 3 * smaller - 1) / 5 if smaller else 0.0))


def _bias_squared(change: Slopes, mask: Mask, normal: np.ndarray, length: np.ndarray) -> ScalarMap:
    """Return the squared tilt by which a larger window differs from a smaller one on the mean of many pixels.

    It is what a quadratic polynomial cannot follow, and what noise leaves of that mean. The latter is not taken off: a bias as
    large could hide in it.
    """
    window = (BIAS_WINDOW_PX, BIAS_WINDOW_PX)
    count = cv2.boxFilter(mask.astype(np.float64), cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    held = np.where(mask, np.clip(np.nan_to_num(change), -1e3, 1e3), 0.0)
    mean = [
        cv2.boxFilter(slope, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
        / np.maximum(count, 1.0)
        for slope in held
    ]
    return _tilt_squared(mean[0], mean[1], normal, length)


def _tilt_squared(slope_p: np.ndarray, slope_q: np.ndarray, normal: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return the squared angle by which a change of the slopes turns the normal."""
    along = slope_p * normal[..., 0] + slope_q * normal[..., 1]
    return np.maximum(slope_p**2 + slope_q**2 - along**2, 0.0) / length**2


def own_slopes(normal: VectorMap, mask: Mask) -> Slopes:
    """Return the slopes that the measured normals tell."""
    up = np.where(mask, normal[..., 2], 1.0)
    return np.stack([np.where(mask, -normal[..., axis] / up, 0.0) for axis in (0, 1)])


def like_noise(fit: WindowFit, mask: Mask) -> Mask:
    """Tell where the heights leave no more than their own noise does, which the draws show."""
    expected = standard_deviation(np.sqrt(fit.drawn_misfit), mask) ** 2
    largest = _largest_share(int(fit.count.max(initial=0)))[fit.count.astype(np.int64)]
    with np.errstate(invalid="ignore"):
        return (fit.count >= 8) & (fit.misfit <= largest * expected)


@cache
def _largest_share(most: int) -> Float64[np.ndarray, " counts"]:
    """Return the largest misfit over the expected one of a smooth window, by the places that it uses, 0 to ``most``."""
    freedom = INDEPENDENT_SHARE * np.maximum(np.arange(most + 1) - 6, 1)
    return np.asarray(chi2.isf(REJECTED_SHARE, freedom) / freedom)


def against_own_normals(fitted: VectorMap, measured: VectorMap, measured_sd_rad: ScalarMap) -> Mask:
    """Tell where a fitted normal contradicts the measured one, at a pixel and at a third of those about it.

    A lone normal that is wrong is none, and is put right by its neighbours.
    """
    turned_squared = ((fitted - measured) ** 2).sum(axis=2)
    with np.errstate(invalid="ignore"):
        against = turned_squared > LARGEST_SQUARE * measured_sd_rad**2
    share = cv2.boxFilter(against.astype(np.float64), cv2.CV_64F, (3, 3), borderType=cv2.BORDER_CONSTANT)
    return against & (share >= CREASE_SHARE)
