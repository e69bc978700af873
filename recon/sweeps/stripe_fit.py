"""Maximum-likelihood place of the stripe in each pixel's intensity curve, with its standard deviation.

The model is ``height = background + amplitude · m(place − stripe; width)`` with the curves m of ``curve_table.py``. Amplitude
and background are linear and solved for at every step; place and logarithm of the width are walked by Gauss–Newton from the
best place of a scan (``stripe_scan.py``). What is known of a pixel's width beforehand (``width_prior.py``) enters as one more
measurement. Samples are independent with the variance of ``noise.py`` at the model's own height; clipped samples are left out.
Where curves have flat tops and sharp corners, the place is the mean of its likelihood instead, and its sd the likelihood's.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int, Int64

from recon.sweeps.curve_lookup import looked_up
from recon.sweeps.curve_samples import CurveSamples, SweepCurves
from recon.sweeps.curve_table import CurveTable
from recon.sweeps.noise import NoiseModel
from recon.sweeps.stripe_scan import FINE_PLACES_A_PX, SCAN_STEPS, best_places, place_spread

GAUSS_NEWTON_STEPS = 6
LARGEST_STEP = 0.5  # of a step of the sweep, and of the logarithm of the width
# The last step is taken and not looked at again: Gauss–Newton leaves a small part of it, and all of it is within the noise.
SETTLED_SD = 0.3
SETTLED_WIDTH_SD = 0.5
# Curves of narrower footprints have flat tops and sharp corners, on which curvature says nothing (device pixels).
ANGULAR_HARD_PX = 0.3
ANGULAR_STEPPED_PX = 0.6
# What is made of so many pixels stays in a core's own cache, and calls are few beside the work in them.
PIXELS_A_BLOCK = 8192


@dataclass(frozen=True, slots=True, eq=False)
class WidthPrior:
    """What is known of each footprint: its shape (``curve_table.SHAPES``), logarithm of its width in px, and that one's sd."""

    shape: Int64[np.ndarray, " pixels"]
    log_width: Float64[np.ndarray, " pixels"]
    sd: Float64[np.ndarray, " pixels"]

    def some(self, pixels: np.ndarray | slice) -> "WidthPrior":
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

    def some(self, pixels: np.ndarray | slice) -> "StripeFit":
        """Return the fit of some of the pixels."""
        return StripeFit(*(getattr(self, name)[pixels] for name in StripeFit.__slots__))


def fit_stripe(
    curves: SweepCurves, pixels: Int[np.ndarray, " pixels"], prior: WidthPrior, *, noise: NoiseModel
) -> StripeFit:
    """Fit the curve of every listed pixel, some thousands at a time so that memory stays small."""
    result = StripeFit(*(np.full(len(pixels), np.nan) for _ in StripeFit.__slots__))
    # Curves of footprints thinner than the table's thinnest are all alike.
    thinnest, widest = curves.table.log_width[[0, -1]]
    prior = WidthPrior(prior.shape, np.clip(prior.log_width, thinnest, widest), prior.sd)
    for low in range(0, len(pixels), PIXELS_A_BLOCK):
        rows = slice(low, low + PIXELS_A_BLOCK)
        part = _fit_block(curves.samples(pixels[rows]), prior.some(rows), table=curves.table, noise=noise)
        for name in StripeFit.__slots__:
            getattr(result, name)[rows] = getattr(part, name)
    return result


def _fit_block(samples: CurveSamples, prior: WidthPrior, *, table: CurveTable, noise: NoiseModel) -> StripeFit:
    """Scan, walk, and where the curve is angular take the likelihood's own mean and spread."""
    black_weight = 1 / noise.read_variance
    weight = weights_of(samples.height, samples, noise)
    start = best_places(samples, weight, black_weight=black_weight, log_width=prior.log_width, table=table)
    start = _about_wide_tops(samples, start, step_px=table.pattern.step_px)
    # The samples' own counts gave the first weights; the curve's heights, free of their noise, give the last.
    curve, _, _ = looked_up(samples, start, prior.log_width, shape=prior.shape, table=table)
    amplitude = _Linear(curve, weight, samples.height, _Sums(weight, samples.height, black_weight)).amplitude
    weight = weights_of(np.multiply(amplitude.astype(np.float32), curve, out=curve), samples, noise)
    angular = np.flatnonzero(np.exp(prior.log_width) < angular_px(table))
    if len(angular) == 0:
        return _walk(samples, start, prior, weight, table=table, noise=noise)
    spread = place_spread(
        samples.some(angular),
        weight[:, angular],
        black_weight=black_weight,
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


def weights_of(height: np.ndarray, samples: CurveSamples, noise: NoiseModel) -> np.ndarray:
    """Return one over the variance that samples of these heights have; zero for those that may not be used."""
    weight: np.ndarray = np.reciprocal(noise.variance(height), dtype=np.float32)
    if not samples.usable.all():
        weight[~samples.usable] = 0.0
    return weight


def _about_wide_tops(samples: CurveSamples, start: np.ndarray, *, step_px: float) -> np.ndarray:
    """Begin in the middle of a top that is wider than the scan; its brightest sample may be anywhere on it."""
    top = samples.height > 0.5 * samples.height[samples.half_width]
    count = np.add.reduce(top, axis=0, dtype=np.float32)
    wide = np.flatnonzero(count > 2 * SCAN_STEPS)
    if len(wide):
        number = np.arange(-samples.half_width, samples.half_width + 1)
        middle = np.einsum("s,sp->p", number, top[:, wide]) / count[wide]
        start[wide] = samples.peak_px[wide] + step_px * middle
    return start


def angular_px(table: CurveTable) -> float:
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
    sums = _Sums(weight, samples.height, 1 / noise.read_variance)
    place, log_width = start, prior.log_width
    best: _Linearised | None = None
    moving = np.arange(len(start))
    lowest, highest = table.log_width[[0, -1]]
    for last in (False,) * (GAUSS_NEWTON_STEPS - 1) + (True,):
        now = _linearise(samples, place, log_width, prior, weight, sums, table=table)
        better = np.ones(len(place), dtype=bool) if best is None else now.objective <= best.objective
        settled = np.abs(now.place_step_px) <= SETTLED_SD * now.sd_px
        settled &= np.abs(now.width_step) <= SETTLED_WIDTH_SD * now.width_sd
        settled &= better
        limit_px = LARGEST_STEP * table.pattern.step_px
        place = now.place_px + np.clip(now.place_step_px, -limit_px, limit_px)
        log_width = now.log_width + np.clip(now.width_step, -LARGEST_STEP, LARGEST_STEP)
        if best is not None and not better.all():
            # A step that made things worse is tried again at a third of its length.
            place = np.where(better, place, best.place_px + (now.place_px - best.place_px) / 3)
            log_width = np.where(better, log_width, best.log_width + (now.log_width - best.log_width) / 3)
            now = now.where(better, best)
        log_width = np.clip(log_width, lowest, highest)
        best = now
        ended = np.arange(len(place)) if last else np.flatnonzero(settled)
        if len(ended) == 0:
            continue
        for name in StripeFit.__slots__:
            getattr(fit, name)[moving[ended]] = getattr(best, name)[ended]
        stepped = np.flatnonzero(settled)
        fit.place_px[moving[stepped]], fit.log_width[moving[stepped]] = place[stepped], log_width[stepped]
        if len(ended) == len(place):
            break
        rest = np.flatnonzero(~settled)
        moving, place, log_width, best = moving[rest], place[rest], log_width[rest], best.some(rest)
        samples, prior, weight, sums = samples.some(rest), prior.some(rest), weight.take(rest, axis=1), sums.some(rest)
    return fit


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """The state at one place and width, and the next Gauss–Newton step."""

    place_px: np.ndarray
    log_width: np.ndarray
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

    def some(self, pixels: np.ndarray) -> "_Linearised":
        """Return the state of some of the pixels."""
        return _Linearised(*(getattr(self, name)[pixels] for name in _Linearised.__slots__))

    def where(self, here: np.ndarray, other: "_Linearised") -> "_Linearised":
        """Return this state ``here``, and the other one elsewhere."""
        return _Linearised(
            *(np.where(here, getattr(self, name), getattr(other, name)) for name in _Linearised.__slots__)
        )


def _linearise(
    samples: CurveSamples,
    place: np.ndarray,
    log_width: np.ndarray,
    prior: WidthPrior,
    weight: np.ndarray,
    sums: "_Sums",
    *,
    table: CurveTable,
) -> _Linearised:
    """Solve for amplitude and background, remove from both derivatives what these could do instead, and step."""
    curve, by_place, by_width = looked_up(samples, place, log_width, shape=prior.shape, table=table)
    linear = _Linear(curve, weight, samples.height, sums)
    amplitude, background = linear.amplitude, linear.background
    place_part, width_part = weight * by_place, weight * by_width
    place_pull, width_pull = linear.explained(place_part), linear.explained(width_part)
    square = amplitude**2
    information = square * (summed(place_part, by_place) - linear.product(place_pull, place_pull))
    mixed = square * (summed(place_part, by_width) - linear.product(place_pull, width_pull))
    own_width = np.maximum(square * (summed(width_part, by_width) - linear.product(width_pull, width_pull)), 0.0)
    curve *= amplitude.astype(np.float32)
    residual = np.subtract(samples.height, curve, out=curve)
    residual -= background.astype(np.float32)
    precision = 1 / prior.sd**2
    place_gradient = amplitude * summed(place_part, residual)
    width_gradient = amplitude * summed(width_part, residual) + precision * (prior.log_width - log_width)
    both = own_width + precision
    # What is left for the place when the width may move with it.
    left = np.maximum(information - mixed**2 / both, 1e-12)
    # Where the curve is flat the step stays within the distance to the next sample.
    damped = left + 1 / (LARGEST_STEP * table.pattern.step_px) ** 2
    place_step = (place_gradient - mixed / both * width_gradient) / damped
    chi_square = np.einsum("sp,sp,sp->p", weight, residual, residual) + sums.black_weight * background**2
    return _Linearised(
        place_px=place,
        log_width=log_width,
        place_step_px=place_step,
        width_step=(width_gradient - mixed * place_step) / both,
        width_sd=1 / np.sqrt(both),
        sd_px=1 / np.sqrt(left),
        amplitude=amplitude,
        background=background,
        width_information=np.maximum(own_width - mixed**2 / np.maximum(information, 1e-12), 0.0),
        chi_square=chi_square,
        objective=chi_square + precision * (log_width - prior.log_width) ** 2,
        freedom=np.maximum(sums.usable - 2.0 - own_width / both, 1.0),
    )


class _Sums:
    """The sums over the samples in which neither place nor width appears."""

    def __init__(self, weight: np.ndarray, height: np.ndarray, black_weight: float) -> None:
        self.black_weight = black_weight
        # The black photo is one more measurement of the background.
        self.s_1 = _total(weight) + black_weight
        self.s_y = summed(weight, height)
        self.usable = np.add.reduce(weight > 0, axis=0, dtype=np.float32).astype(np.float64)

    def some(self, pixels: np.ndarray) -> "_Sums":
        """Return the sums of some of the pixels."""
        those = copy(self)
        those.s_1, those.s_y, those.usable = self.s_1[pixels], self.s_y[pixels], self.usable[pixels]
        return those


class _Linear:
    """Amplitude and background at a given place and width, by the two normal equations."""

    def __init__(self, curve: np.ndarray, weight: np.ndarray, height: np.ndarray, sums: _Sums) -> None:
        self._curve = curve
        weighted = weight * curve
        self._s_mm = summed(weighted, curve) + 1e-12
        self._s_m = _total(weighted)
        self._s_1 = sums.s_1
        self._determinant = np.maximum(self._s_mm * self._s_1 - self._s_m**2, 1e-7 * self._s_mm * self._s_1)
        s_my = summed(weighted, height)
        self.amplitude = (self._s_1 * s_my - self._s_m * sums.s_y) / self._determinant
        self.background = (self._s_mm * sums.s_y - self._s_m * s_my) / self._determinant

    def explained(self, weighted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the products of a weighted derivative with the derivatives by amplitude and by background."""
        return summed(weighted, self._curve), _total(weighted)

    def product(self, a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return aᵀ N⁻¹ b with the normal matrix N: what amplitude and background take of an information."""
        cross = self._s_1 * a[0] * b[0] - self._s_m * (a[0] * b[1] + a[1] * b[0]) + self._s_mm * a[1] * b[1]
        return cross / self._determinant


def summed(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the sum over the samples of a product, without the array of products."""
    return np.einsum("sp,sp->p", first, second).astype(np.float64)


def _total(values: np.ndarray) -> np.ndarray:
    """Return the sum over the samples."""
    return np.add.reduce(values, axis=0).astype(np.float64)
