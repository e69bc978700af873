"""A tile's surface as heights over its own plane: a polynomial about every pixel, and where the pixel's sight meets it."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64
from scipy.special import chdtri

from recon.surface.error_draws import standard_deviation
from recon.surface.lateral_places import LateralPlaces
from recon.surface.noise_reference import NoiseReference
from recon.surface.patch_loops import add_moves, mean_tilt_squared
from recon.surface.ray_chords import Mask, ScalarMap, VectorMap
from recon.surface.window_bias import ClearSlopes, Slopes, bias_left, without_bias
from recon.surface.window_quadratic import Lines, WindowFit

# One in a thousand smooth normals is turned down for its noise.
REJECTED_SHARE = 1e-3
# Of smooth windows far fewer: the smaller one that takes the place of one that noise turned down errs more than its sd says.
REJECTED_WINDOWS = 1e-5
# Residuals of the fused surface are those of neighbours that share their normals: they count half.
INDEPENDENT_SHARE = 0.5
# As many places as leave two more than a quadratic polynomial has terms.
FEWEST_PLACES = 8
# Windows about a pixel that tell together whether they hold; a straight crease leaves the vote where it is. By itself a window
# is left only for residuals that hardly any noise leaves.
VOTE_WINDOW_PX, FAR_MORE = 9, 1.5
LARGEST_SQUARE = float(chdtri(1, REJECTED_SHARE))
# A window three pixels wide bends through a crease without a residual, but not without turning three of nine normals.
CREASE_SHARE = 1 / 3 - 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """Where a tile's pixels look: a line along the sight through each lateral place, in the tile's own frame and unit."""

    lines: Lines
    across: Float64[np.ndarray, "2 3"]
    variance: Float64[np.ndarray, "2 rows cols"]
    error: Float32[np.ndarray, "2 draws rows cols"]
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
            lines=Lines(offset @ lateral.axes[:2] @ frame.T / unit_mm, frame @ lateral.axes[2]),
            across=lateral.axes[:2] @ frame.T,
            variance=lateral.variance[(slice(None), *wide)] / unit_mm**2,
            error=lateral.error_mm[(slice(None), slice(None), *wide)].astype(np.float32) / np.float32(unit_mm),
            middle_mm=middle_mm,
            unit_mm=unit_mm,
            frame=frame,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A tile's points and normals in its own frame and unit, with their standard deviations.

    ``left_squared`` is the part of the normals' variance that is bias.
    """

    point: Float64[np.ndarray, "rows cols 3"]
    normal: Float64[np.ndarray, "rows cols 3"]
    sd: ScalarMap
    across_sd: ScalarMap
    normal_sd: ScalarMap
    left_squared: ScalarMap


def patch_of(
    fit: WindowFit,
    place: Sight,
    mask: Mask,
    before: ClearSlopes,
    trust: ScalarMap,
    noise: NoiseReference,
    straight_px: ScalarMap,
    *,
    half_width: int,
    smaller: int,
) -> tuple[Patch, ClearSlopes]:
    """Let each pixel's line of sight meet its polynomial, and carry the draws and the lateral place's sd along.

    ``before`` are the slopes of the next smaller window; those of this one are returned for the next larger. ``whole_bias`` times
    their difference, which counts by its ``trust`` (0 to 1), is the bias of this one: a window across a crease says nothing of
    others. The tilt of a window and the turn by its lateral place come from the same paths: a path that is off by noise sees the
    normal of another place, and looking for the normal at the place that it tells puts much of that right. So ``noise`` is told
    of draws of both together. ``straight_px`` is how far each pixel is from the rim.
    """
    sight, slopes = place.lines.sight, np.stack([fit.slope_p, fit.slope_q])
    point = place.lines.start + fit.along[..., None] * sight
    length = np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
    # Of the normal, the parts along p and q, and how much of it is along the sight.
    normal = -slopes / length
    facing = normal[0] * sight[0] + normal[1] * sight[1] + sight[2] / length
    facing = np.where(np.abs(facing) > 1e-3, facing, 1e-3)
    rate = np.empty((2, 2, *mask.shape), np.float32)
    slide_variance = np.zeros(mask.shape)
    for axis, variance, slope_rate in zip(place.across, place.variance, rate, strict=True):
        # How the point, and the slopes there, move when the lateral place does.
        share = (normal[0] * axis[0] + normal[1] * axis[1] + axis[2] / length) / facing
        move = [axis[k] - share * sight[k] for k in range(3)]
        slide_variance += variance * (move[0] ** 2 + move[1] ** 2 + move[2] ** 2)
        _, _, _, pp, pq, qq = fit.coefficients
        slope_rate[0] = 2 * pp * move[0] + pq * move[1]
        slope_rate[1] = pq * move[0] + 2 * qq * move[1]
    now = Slopes(slopes, _moved(fit.drawn[1:], rate, place.error), fit.variance[1] + fit.variance[2])
    sizes = {"half_width": half_width, "smaller": smaller}
    clear, left, left_drawn = without_bias(now, before, trust, noise.depth_px, straight_px, noise.within, **sizes)
    # Smaller windows are not used, and their noise is not that of the others.
    enough = mask & (fit.count >= FEWEST_PLACES)
    noise_squared = noise.smoothed(
        _mean_tilt_squared(clear.drawn, normal, length), now.variance, enough, half_width=half_width
    )
    bias_squared = bias_left(
        _mean_tilt_squared(left[:, None], normal, length),
        _mean_tilt_squared(left_drawn, normal, length),
        before,
        enough & noise.within,
        noise.depth_px,
        **sizes,
    )
    lifted = standard_deviation(fit.drawn[0], mask) / length
    patch = Patch(
        point=point,
        normal=_unit(-clear.slope[0], -clear.slope[1]),
        sd=np.sqrt(slide_variance + (lifted / facing) ** 2),
        across_sd=lifted,
        normal_sd=np.sqrt(noise_squared + bias_squared),
        left_squared=bias_squared,
    )
    return patch, ClearSlopes(now, clear, bias_squared)


def _unit(p: ScalarMap, q: ScalarMap) -> VectorMap:
    """Return the unit vectors along (p, q, 1)."""
    length = np.sqrt(p * p + q * q + 1)
    return np.stack([p / length, q / length, 1 / length], axis=-1)


def _moved(
    slopes: Float32[np.ndarray, "2 draws rows cols"],
    rate: Float32[np.ndarray, "axes 2 rows cols"],
    error: Float32[np.ndarray, "axes draws rows cols"],
) -> Float32[np.ndarray, "2 draws rows cols"]:
    """Return draws' slopes where the ``error`` of their lateral place lets the pixel look; they change at a ``rate`` per axis."""
    result = np.empty_like(slopes)
    add_moves(slopes, rate, error, result)
    return result


def _mean_tilt_squared(
    slopes: Float[np.ndarray, "2 draws rows cols"],
    normal: Float64[np.ndarray, "2 rows cols"],
    length: ScalarMap,
) -> ScalarMap:
    """Return :func:`mean_tilt_squared` of changes of the slopes."""
    result = np.empty_like(length)
    mean_tilt_squared(slopes, normal, length, result)
    return result


def beyond_noise(fit: WindowFit, mask: Mask) -> ScalarMap:
    """Return what the heights leave over the most that their noise may leave, which the draws show; NaN with too few places."""
    expected = standard_deviation(np.sqrt(fit.drawn_misfit)[None], mask) ** 2
    largest = _largest_share(int(fit.count.max(initial=0)))[fit.count.astype(np.int64)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(fit.count >= FEWEST_PLACES, fit.misfit / (largest * expected), np.nan)


def within_noise(beyond: ScalarMap) -> Mask:
    """Tell which windows hold: most of those about them leave no more than noise explains, and they themselves not far more.

    By its own residuals alone a window would be left for a smaller one where that happens to err most: what it leaves is what
    the smaller one errs by. ``beyond`` is that of :func:`beyond_noise`.
    """
    size = (VOTE_WINDOW_PX, VOTE_WINDOW_PX)
    more, told = (
        cv2.boxFilter(each.astype(np.float64), cv2.CV_64F, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for each in (beyond > 1, np.isfinite(beyond))
    )
    return np.asarray((2 * more <= told) & (beyond <= FAR_MORE))


@cache
def _largest_share(most: int) -> Float64[np.ndarray, " counts"]:
    """Return the largest misfit over the expected one of a smooth window, by the places that it uses, 0 to ``most``."""
    freedom = INDEPENDENT_SHARE * np.maximum(np.arange(most + 1) - 6, 1)
    return np.asarray(chdtri(freedom, REJECTED_WINDOWS) / freedom)


def against_own_normals(fitted: VectorMap, measured: VectorMap, measured_sd_rad: ScalarMap) -> Mask:
    """Tell where a fitted normal contradicts the measured one, at a pixel and at a third of those about it.

    A lone normal that is wrong is none, and is put right by its neighbours.
    """
    turned_squared = ((fitted - measured) ** 2).sum(axis=2)
    with np.errstate(invalid="ignore"):
        against = turned_squared > LARGEST_SQUARE * measured_sd_rad**2
    share = cv2.boxFilter(against.astype(np.float64), cv2.CV_64F, (3, 3), borderType=cv2.BORDER_CONSTANT)
    return against & (share >= CREASE_SHARE)
