"""Maximum-likelihood place of the stripe in each pixel's intensity curve, with its standard deviation.

The model is ``intensity = background + amplitude · m(x − place)`` with m from ``stripe_model.py``; amplitude and background
are linear and solved for at every step. Samples are independent with variance ``read + gain · signal`` (noise.py); clipped
samples are left out. Where the curve fixes the place only to an interval (a stripe seen in one photo alone) the mean
and spread of the likelihood over that interval are returned, since the curvature at its maximum means nothing.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from recon.sessions.manifest import StripePattern
from recon.sweeps.noise import NoiseModel
from recon.sweeps.stripe_model import expected_curve
from recon.sweeps.stripe_peak import PeakWindows

GAUSS_NEWTON_STEPS = 8
# A step of the iteration may not leave the neighbourhood of the brightest sample.
LARGEST_CORRECTION_STEPS = 0.5
# Beyond this sd (in stripe steps) the curve's peak is flat on the scale of the curve itself.
INTERVAL_SD_STEPS = 0.03
GRID_POINTS = 41
PIXELS_A_CHUNK = 4096


@dataclass(frozen=True, slots=True, eq=False)
class CurveSamples:
    """Samples about the peak of each pixel: counts, places in device pixels, which may be used, and the black level."""

    counts: Float64[np.ndarray, "pixels samples"]
    place_px: Float64[np.ndarray, "pixels samples"]
    usable: Bool[np.ndarray, "pixels samples"]
    black: Float64[np.ndarray, " pixels"]

    def some(self, pixels: np.ndarray) -> "CurveSamples":
        """Return the samples of some of the pixels."""
        return CurveSamples(self.counts[pixels], self.place_px[pixels], self.usable[pixels], self.black[pixels])


def curve_samples(
    windows: PeakWindows, pixels: np.ndarray, *, black: np.ndarray, pattern: StripePattern, clipped: int
) -> CurveSamples:
    """Make the samples of these pixels ready to fit; ``black`` [rows * cols] counts, ``clipped`` the first clipped count."""
    counts = windows.samples[pixels].astype(np.float64)
    place = windows.peak_index[pixels, None] + np.arange(-windows.half_width, windows.half_width + 1)
    inside = (place >= 0) & (place < windows.photo_count)
    return CurveSamples(
        counts=counts,
        place_px=pattern.first_px + pattern.step_px * place.astype(np.float64),
        usable=inside & (counts < clipped),
        black=black[pixels].astype(np.float64),
    )


@dataclass(frozen=True, slots=True, eq=False)
class StripeFit:
    """Place and sd in device pixels, amplitude and background in counts, weighted residual and degrees of freedom."""

    place_px: Float64[np.ndarray, " pixels"]
    sd_px: Float64[np.ndarray, " pixels"]
    amplitude: Float64[np.ndarray, " pixels"]
    background: Float64[np.ndarray, " pixels"]
    chi_square: Float64[np.ndarray, " pixels"]
    freedom: Float64[np.ndarray, " pixels"]


def fit_stripe(
    windows: PeakWindows,
    pixels: Int64[np.ndarray, " pixels"],
    start_px: Float64[np.ndarray, " pixels"],
    footprint_px: Float64[np.ndarray, "pixels 2"],
    *,
    black: np.ndarray,
    pattern: StripePattern,
    noise: NoiseModel,
    clipped: int,
    continuous: bool,
    intervals: bool = True,
) -> StripeFit:
    """Fit the curve of every listed pixel, some thousands at a time so that memory stays small.

    ``start_px`` is a first guess within two steps of the answer, ``footprint_px`` the two box widths of the pixel's footprint
    on the display, in device pixels. ``intervals=False`` skips the slow treatment of places known only to an interval, for
    a round whose result is refined again.
    """
    parts = []
    for low in range(0, max(len(pixels), 1), PIXELS_A_CHUNK):
        part = slice(low, low + PIXELS_A_CHUNK)
        samples = curve_samples(windows, pixels[part], black=black, pattern=pattern, clipped=clipped)
        parts.append(
            _fit_chunk(
                samples,
                start_px[part],
                footprint_px[part],
                pattern=pattern,
                noise=noise,
                continuous=continuous,
                intervals=intervals,
            )
        )
    return StripeFit(*(np.concatenate([getattr(part, name) for part in parts]) for name in StripeFit.__slots__))


def _fit_chunk(
    samples: CurveSamples,
    start_px: np.ndarray,
    footprint_px: np.ndarray,
    *,
    pattern: StripePattern,
    noise: NoiseModel,
    continuous: bool,
    intervals: bool,
) -> StripeFit:
    place = start_px.copy()
    limit = LARGEST_CORRECTION_STEPS * pattern.step_px
    moving = np.arange(len(place))
    for _ in range(GAUSS_NEWTON_STEPS):
        step = _linearise(
            samples.some(moving),
            place[moving],
            footprint_px[moving],
            pattern=pattern,
            noise=noise,
            continuous=continuous,
        )
        farthest = 2 * pattern.step_px
        place[moving] = np.clip(
            place[moving] + np.clip(step.correction, -limit, limit),
            start_px[moving] - farthest,
            start_px[moving] + farthest,
        )
        # A step of a hundredth of the standard deviation changes nothing that could be seen.
        moving = moving[np.abs(step.correction) * np.sqrt(step.information) > 0.01]
        if len(moving) == 0:
            break
    state = _linearise(samples, place, footprint_px, pattern=pattern, noise=noise, continuous=continuous)
    sd = 1 / np.sqrt(np.maximum(state.information, 1e-30))
    vague = intervals & ((sd > INTERVAL_SD_STEPS * pattern.step_px) | (np.abs(state.correction) > 0.2 * sd))
    if vague.any():
        place[vague], sd[vague] = _interval(
            samples.some(vague),
            start_px[vague],
            footprint_px[vague],
            pattern=pattern,
            noise=noise,
            continuous=continuous,
        )
        state = _linearise(samples, place, footprint_px, pattern=pattern, noise=noise, continuous=continuous)
    freedom = np.maximum(samples.usable.sum(axis=1) + 1.0 - 3.0, 1.0)
    # Where the curve is not quite the model's, the misfit is taken as noise of the same kind (Birge's ratio).
    sd *= np.sqrt(np.maximum(state.chi_square / freedom, 1.0))
    return StripeFit(place, sd, state.amplitude, state.background, state.chi_square, freedom)


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    amplitude: np.ndarray
    background: np.ndarray
    chi_square: np.ndarray
    correction: np.ndarray
    information: np.ndarray


def _linearise(
    samples: CurveSamples,
    place: np.ndarray,
    footprint_px: np.ndarray,
    *,
    pattern: StripePattern,
    noise: NoiseModel,
    continuous: bool,
) -> _Linearised:
    """Solve for amplitude and background at these places, and for the next Gauss–Newton step of the place."""
    shape, slope = expected_curve(samples.place_px, place, footprint_px, pattern=pattern, continuous=continuous)
    height = samples.counts - samples.black[:, None]
    weight = samples.usable / noise.variance(height)
    # The black photo is one more measurement of the background.
    black_weight = 1 / noise.variance(np.zeros(1))[0]
    linear = _linear_part(weight, shape, height, black_weight)
    residual = height - linear.amplitude[:, None] * shape - linear.background[:, None]
    by_place = linear.amplitude[:, None] * slope
    # Remove from the derivative what amplitude and background could do instead.
    s_dm = _row_sums(weight * by_place, shape)
    s_d = _row_sums(weight, by_place)
    toward_m = (linear.s_1 * s_dm - linear.s_m * s_d) / linear.determinant
    toward_1 = (linear.s_mm * s_d - linear.s_m * s_dm) / linear.determinant
    own = by_place - toward_m[:, None] * shape - toward_1[:, None]
    information = _row_sums(weight * own, own) + black_weight * toward_1**2
    gradient = _row_sums(weight * own, residual) + black_weight * toward_1 * linear.background
    chi_square = _row_sums(weight * residual, residual) + black_weight * linear.background**2
    return _Linearised(
        linear.amplitude,
        linear.background + samples.black,
        chi_square,
        gradient / np.maximum(information, 1e-12),
        information,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _LinearPart:
    """Amplitude and background at a given place, with the sums of their normal equations."""

    amplitude: np.ndarray
    background: np.ndarray
    s_mm: np.ndarray
    s_m: np.ndarray
    s_1: np.ndarray
    determinant: np.ndarray


def _linear_part(weight: np.ndarray, shape: np.ndarray, height: np.ndarray, black_weight: float) -> _LinearPart:
    weighted = weight * shape
    s_mm = _row_sums(weighted, shape) + 1e-12
    s_m = weighted.sum(1)
    s_1 = weight.sum(1) + black_weight
    s_my = _row_sums(weighted, height)
    s_y = _row_sums(weight, height)
    determinant = np.maximum(s_mm * s_1 - s_m**2, 1e-12)
    return _LinearPart(
        amplitude=(s_1 * s_my - s_m * s_y) / determinant,
        background=(s_mm * s_y - s_m * s_my) / determinant,
        s_mm=s_mm,
        s_m=s_m,
        s_1=s_1,
        determinant=determinant,
    )


def _row_sums(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the sum of products along each row, without the array of products."""
    return np.einsum("ps,ps->p", first, second)


def _profile_chi_square(
    samples: CurveSamples,
    place: np.ndarray,
    footprint_px: np.ndarray,
    weight: np.ndarray,
    *,
    pattern: StripePattern,
    continuous: bool,
    black_weight: float,
) -> np.ndarray:
    """Return chi-square at these places with amplitude and background at their best."""
    shape, _ = expected_curve(samples.place_px, place, footprint_px, pattern=pattern, continuous=continuous)
    height = samples.counts - samples.black[:, None]
    linear = _linear_part(weight, shape, height, black_weight)
    residual = height - linear.amplitude[:, None] * shape - linear.background[:, None]
    return _row_sums(weight * residual, residual) + black_weight * linear.background**2


def _interval(
    samples: CurveSamples,
    start_px: np.ndarray,
    footprint_px: np.ndarray,
    *,
    pattern: StripePattern,
    noise: NoiseModel,
    continuous: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and sd of the place under the profile likelihood, over a grid about the brightest sample."""
    grid = np.linspace(-1.25, 1.25, GRID_POINTS) * max(pattern.step_px, 1.0)
    weight = samples.usable / noise.variance(samples.counts - samples.black[:, None])
    black_weight = float(1 / noise.variance(np.zeros(1))[0])
    chi_square = np.stack(
        [
            _profile_chi_square(
                samples,
                start_px + offset,
                footprint_px,
                weight,
                pattern=pattern,
                continuous=continuous,
                black_weight=black_weight,
            )
            for offset in grid
        ],
        axis=1,
    )
    likelihood = np.exp(-0.5 * (chi_square - chi_square.min(axis=1, keepdims=True)))
    likelihood /= likelihood.sum(axis=1, keepdims=True)
    mean = likelihood @ grid
    variance = likelihood @ grid**2 - mean**2
    # The grid itself is a uniform quantisation of its spacing.
    spacing = grid[1] - grid[0]
    return start_px + mean, np.sqrt(np.maximum(variance, 0.0) + spacing**2 / 12)
