"""Maximum-likelihood place of the stripe in each pixel's intensity curve, with its standard deviation.

The model is ``height = background + amplitude · m(place − stripe; width)`` with the curves m of ``curve_table.py``. Amplitude
and background are linear and solved for at every step; place and logarithm of the width are walked by Gauss–Newton from the
best place of a scan (``stripe_scan.py``). What is known of a pixel's width beforehand (``width_prior.py``) enters as one more
measurement. Samples are independent with the variance of ``noise.py`` at the model's own height; clipped samples are left out.
Where curves have flat tops and sharp corners, the place is the mean of its likelihood instead, and its sd the likelihood's.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from recon.sweeps.curve_samples import CurveSamples, SweepCurves
from recon.sweeps.curve_table import NODE_SPACING, CurveTable
from recon.sweeps.noise import NoiseModel
from recon.sweeps.stripe_scan import FINE_PLACES_A_PX, SCAN_STEPS, best_places, place_spread

GAUSS_NEWTON_STEPS = 6
LARGEST_STEP = 0.5  # of a step of the sweep, and of the logarithm of the width
# A step of a twentieth of the standard deviation changes nothing that could be seen.
SETTLED_SD = 0.05
SETTLED_WIDTH_SD = 0.2
# Curves of narrower footprints have flat tops and sharp corners, on which curvature says nothing (device pixels).
ANGULAR_HARD_PX = 0.3
ANGULAR_STEPPED_PX = 0.6
PIXELS_A_CHUNK = 8192


@dataclass(frozen=True, slots=True, eq=False)
class WidthPrior:
    """What is known of each footprint: its shape (``curve_table.SHAPES``), logarithm of its width in px, and that one's sd."""

    shape: Int64[np.ndarray, " pixels"]
    log_width: Float64[np.ndarray, " pixels"]
    sd: Float64[np.ndarray, " pixels"]

    def some(self, pixels: np.ndarray) -> "WidthPrior":
        """Return the prior of some of the pixels."""
        return WidthPrior(self.shape[pixels], self.log_width[pixels], self.sd[pixels])


@dataclass(frozen=True, slots=True, eq=False)
class StripeFit:
    """What was fitted to each pixel.

    Place and sd in device pixels, amplitude and background in counts above black, the logarithm of the width with the
    information (1 / variance) that the curve itself holds on it, weighted residual and degrees of freedom.
    """

    place_px: Float64[np.ndarray, " pixels"]
    sd_px: Float64[np.ndarray, " pixels"]
    amplitude: Float64[np.ndarray, " pixels"]
    background: Float64[np.ndarray, " pixels"]
    log_width: Float64[np.ndarray, " pixels"]
    width_information: Float64[np.ndarray, " pixels"]
    chi_square: Float64[np.ndarray, " pixels"]
    freedom: Float64[np.ndarray, " pixels"]


def fit_stripe(
    curves: SweepCurves, pixels: Int64[np.ndarray, " pixels"], prior: WidthPrior, *, noise: NoiseModel
) -> StripeFit:
    """Fit the curve of every listed pixel, some thousands at a time so that memory stays small."""
    table = curves.table
    result = StripeFit(*(np.full(len(pixels), np.nan) for _ in StripeFit.__slots__))
    # Pixels of nearly one footprint stand together, so that a scan of many is one matrix product.
    order = np.lexsort((prior.shape, table.nearest_node(prior.log_width)))
    for low in range(0, len(order), PIXELS_A_CHUNK):
        rows = order[low : low + PIXELS_A_CHUNK]
        part = _fit_chunk(curves.samples(pixels[rows]), prior.some(rows), table=table, noise=noise)
        for name in StripeFit.__slots__:
            getattr(result, name)[rows] = getattr(part, name)
    return result


def _fit_chunk(samples: CurveSamples, prior: WidthPrior, *, table: CurveTable, noise: NoiseModel) -> StripeFit:
    """Scan, walk, and where the curve is angular take the likelihood's own mean and spread."""
    weight = (samples.usable / noise.variance(samples.height)).astype(np.float32)
    start = best_places(samples, weight, black_weight=1 / noise.read_variance, log_width=prior.log_width, table=table)
    start = _about_wide_tops(samples, start, step_px=table.pattern.step_px)
    # The samples' own counts gave the first weights; the curve's heights, free of their noise, give the last.
    curve, _, _ = looked_up(samples, start, prior.log_width, shape=prior.shape, table=table)
    amplitude = _Linear(curve, weight, samples.height, 1 / noise.read_variance).amplitude
    lit = amplitude.astype(np.float32)[:, None] * curve
    weight = (samples.usable / noise.variance(lit)).astype(np.float32)
    angular = np.flatnonzero(np.exp(prior.log_width) < _angular_px(table))
    if len(angular) == 0:
        return _walk(samples, start, prior, weight, table=table, noise=noise)
    spread = place_spread(
        samples.some(angular),
        weight[angular],
        black_weight=1 / noise.read_variance,
        log_width=prior.log_width[angular],
        width_sd=prior.sd[angular],
        shape=prior.shape[angular],
        table=table,
        about_px=start[angular],
    )
    # On a flat top the walk has nothing to go by: it begins where the finer grid is best.
    start[angular] = spread.best_px
    fit = _walk(samples, start, prior, weight, table=table, noise=noise)
    spacing = min(table.pattern.step_px, 1.0) / FINE_PLACES_A_PX
    # The grid is too coarse for the sharpest likelihoods, and the curvature right where it is that sharp.
    curved = np.maximum(fit.sd_px[angular], spread.sd_px) < spacing
    fit.place_px[angular] = np.where(curved, fit.place_px[angular], spread.mean_px)
    fit.sd_px[angular] = np.where(
        curved, np.maximum(fit.sd_px[angular], spread.sd_px), np.maximum(spread.sd_px, spacing / np.sqrt(12))
    )
    return fit


def _about_wide_tops(samples: CurveSamples, start: np.ndarray, *, step_px: float) -> np.ndarray:
    """Begin in the middle of a top that is wider than the scan; its brightest sample may be anywhere on it."""
    top = samples.height > 0.5 * samples.height[:, samples.half_width, None]
    count = top.sum(axis=1)
    number = np.arange(-samples.half_width, samples.half_width + 1)
    middle = samples.peak_px + step_px * (top @ number) / np.maximum(count, 1)
    return np.where(count > 2 * SCAN_STEPS, middle, start)


def _angular_px(table: CurveTable) -> float:
    """Return the width of a footprint below which curves have flat tops and sharp corners."""
    if not table.continuous:
        return ANGULAR_STEPPED_PX
    return ANGULAR_HARD_PX * table.pattern.step_px if table.pattern.profile == "hard" else 0.0


def _walk(
    samples: CurveSamples,
    start: np.ndarray,
    prior: WidthPrior,
    weight: np.ndarray,
    *,
    table: CurveTable,
    noise: NoiseModel,
) -> StripeFit:
    """Walk place and width to the least chi-square by Gauss–Newton."""
    fit = StripeFit(*(np.zeros(len(start)) for _ in StripeFit.__slots__))
    fit.place_px[:], fit.log_width[:] = start, prior.log_width
    tried = np.stack([start, prior.log_width], axis=1)
    least = np.full(len(start), np.inf)
    moving = np.arange(len(start))
    limit = np.array([LARGEST_STEP * table.pattern.step_px, LARGEST_STEP])
    lowest, highest = table.log_width[[0, -1]]
    for _ in range(GAUSS_NEWTON_STEPS):
        now = _linearise(
            samples.some(moving),
            tried[moving, 0],
            tried[moving, 1],
            prior.some(moving),
            weight[moving],
            table=table,
            noise=noise,
        )
        better = now.objective <= least[moving]
        taken = moving[better]
        fit.place_px[taken], fit.log_width[taken] = tried[taken].T
        least[taken] = now.objective[better]
        for name in ("sd_px", "amplitude", "background", "width_information", "chi_square", "freedom"):
            getattr(fit, name)[taken] = getattr(now, name)[better]
        step = np.clip(np.stack([now.place_step_px, now.width_step], axis=1), -limit, limit)
        # A step that made things worse is tried again at a third of its length.
        back = np.stack([fit.place_px, fit.log_width], axis=1)[moving]
        tried[moving] = np.where(better[:, None], tried[moving] + step, back + (tried[moving] - back) / 3)
        tried[moving, 1] = np.clip(tried[moving, 1], lowest, highest)
        settled = np.abs(now.place_step_px) <= SETTLED_SD * now.sd_px
        settled &= np.abs(now.width_step) <= SETTLED_WIDTH_SD * now.width_sd
        moving = moving[~(settled & better)]
        if len(moving) == 0:
            break
    return fit


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """The state at the present place and width, and the next Gauss–Newton step."""

    place_step_px: np.ndarray
    width_step: np.ndarray
    width_sd: np.ndarray
    sd_px: np.ndarray
    amplitude: np.ndarray
    background: np.ndarray
    width_information: np.ndarray
    chi_square: np.ndarray
    objective: np.ndarray  # chi-square with the prior's part
    freedom: np.ndarray


def _linearise(
    samples: CurveSamples,
    place: np.ndarray,
    log_width: np.ndarray,
    prior: WidthPrior,
    weight: np.ndarray,
    *,
    table: CurveTable,
    noise: NoiseModel,
) -> _Linearised:
    """Solve for amplitude and background, remove from both derivatives what these could do instead, and step."""
    curve, by_place, by_width = looked_up(samples, place, log_width, shape=prior.shape, table=table)
    # The black photo is one more measurement of the background.
    black_weight = 1 / noise.read_variance
    linear = _Linear(curve, weight, samples.height, black_weight)
    amplitude, background = linear.amplitude, linear.background
    lit = amplitude.astype(np.float32)[:, None] * curve
    residual = samples.height - lit - background.astype(np.float32)[:, None]
    weighted_residual = weight * residual
    place_part, width_part = weight * by_place, weight * by_width
    place_pull, width_pull = linear.explained(place_part), linear.explained(width_part)
    square = amplitude**2
    information = square * (_row_sums(place_part, by_place) - linear.product(place_pull, place_pull))
    mixed = square * (_row_sums(place_part, by_width) - linear.product(place_pull, width_pull))
    own_width = np.maximum(square * (_row_sums(width_part, by_width) - linear.product(width_pull, width_pull)), 0.0)
    precision = 1 / prior.sd**2
    place_gradient = amplitude * _row_sums(by_place, weighted_residual)
    width_gradient = amplitude * _row_sums(by_width, weighted_residual) + precision * (prior.log_width - log_width)
    both = own_width + precision
    # What is left for the place when the width may move with it.
    left = np.maximum(information - mixed**2 / both, 1e-12)
    # Where the curve is flat the step stays within the distance to the next sample.
    damped = left + 1 / (LARGEST_STEP * table.pattern.step_px) ** 2
    place_step = (place_gradient - mixed / both * width_gradient) / damped
    chi_square = _row_sums(weighted_residual, residual) + black_weight * background**2
    return _Linearised(
        place_step_px=place_step,
        width_step=(width_gradient - mixed * place_step) / both,
        width_sd=1 / np.sqrt(both),
        sd_px=1 / np.sqrt(left),
        amplitude=amplitude,
        background=background,
        width_information=np.maximum(own_width - mixed**2 / np.maximum(information, 1e-12), 0.0),
        chi_square=chi_square,
        objective=chi_square + precision * (log_width - prior.log_width) ** 2,
        freedom=np.maximum(samples.usable.sum(axis=1) - 2.0 - own_width / both, 1.0),
    )


class _Linear:
    """Amplitude and background at a given place and width, by the two normal equations."""

    def __init__(self, curve: np.ndarray, weight: np.ndarray, height: np.ndarray, black_weight: float) -> None:
        self._curve = curve
        weighted = weight * curve
        self._s_mm = _row_sums(weighted, curve) + 1e-12
        self._s_m = weighted.sum(axis=1, dtype=np.float64)
        self._s_1 = weight.sum(axis=1, dtype=np.float64) + black_weight
        self._determinant = np.maximum(self._s_mm * self._s_1 - self._s_m**2, 1e-7 * self._s_mm * self._s_1)
        s_my, s_y = _row_sums(weighted, height), _row_sums(weight, height)
        self.amplitude = (self._s_1 * s_my - self._s_m * s_y) / self._determinant
        self.background = (self._s_mm * s_y - self._s_m * s_my) / self._determinant

    def explained(self, weighted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the products of a weighted derivative with the derivatives by amplitude and by background."""
        return _row_sums(weighted, self._curve), weighted.sum(axis=1, dtype=np.float64)

    def product(self, a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return aᵀ N⁻¹ b with the normal matrix N: what amplitude and background take of an information."""
        cross = self._s_1 * a[0] * b[0] - self._s_m * (a[0] * b[1] + a[1] * b[0]) + self._s_mm * a[1] * b[1]
        return cross / self._determinant


def looked_up(
    samples: CurveSamples, place: np.ndarray, log_width: np.ndarray, *, shape: np.ndarray, table: CurveTable
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each pixel's curve at its samples, and the derivatives by place and by the width's logarithm."""
    _, nodes, kinds, entries = table.value.shape
    node = np.clip(((log_width - table.log_width[0]) / NODE_SPACING).astype(np.int64), 0, len(table.log_width) - 2)
    table.fill(np.concatenate([shape, shape]), np.concatenate([node, node + 1]))
    share = np.clip((log_width - table.log_width[node]) / NODE_SPACING, 0.0, 1.0).astype(np.float32)[:, None]
    distance = place - samples.peak_px
    entry = table.entry(distance)
    rest = (distance + table.reach_px - entry * table.spacing_px).astype(np.float32)[:, None]
    offset = np.arange(-samples.half_width, samples.half_width + 1)
    index = np.clip(entry[:, None] - table.entries_a_step * offset, 0, entries - 1)
    if kinds > 1:
        index += table.alignment_of[samples.peak[:, None] + offset + table.pad] * entries
    index += ((shape * nodes + node) * (kinds * entries))[:, None]
    values, slopes = table.value.ravel(), table.slope.ravel()
    beyond = index + kinds * entries
    curve, slope = values.take(index), slopes.take(index)
    by_width, slope_by_width = values.take(beyond) - curve, slopes.take(beyond) - slope
    slope += share * slope_by_width
    curve += share * by_width + rest * slope
    by_width /= np.float32(NODE_SPACING)
    return curve, slope, by_width


def leverage_of(
    samples: CurveSamples, fit: StripeFit, prior: WidthPrior, *, table: CurveTable, noise: NoiseModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the fitted height, the residual and the leverage of every sample.

    The leverage is the share of a sample's noise that the fit follows: a residual has (1 − leverage) times its variance.
    """
    curve, by_place, by_width = looked_up(samples, fit.place_px, fit.log_width, shape=prior.shape, table=table)
    amplitude = fit.amplitude[:, None].astype(np.float32)
    lit = amplitude * curve
    residual = samples.height - lit - fit.background[:, None].astype(np.float32)
    weight = samples.usable / noise.variance(lit)
    design = np.stack([curve, np.ones_like(curve), amplitude * by_place, amplitude * by_width], axis=-1)
    normal = np.einsum("ps,psi,psj->pij", weight, design, design, optimize=True).astype(np.float64)
    normal[:, 1, 1] += 1 / noise.read_variance
    normal[:, 3, 3] += 1 / prior.sd**2
    # A parameter that the curve does not hold follows nothing.
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    leverage = weight * np.einsum("psi,pij,psj->ps", design, np.linalg.inv(normal), design, optimize=True)
    return lit, residual, leverage


def _row_sums(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the sum of products along each row, without the array of products."""
    return np.einsum("ps,ps->p", first, second).astype(np.float64)
