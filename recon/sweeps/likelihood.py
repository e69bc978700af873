"""From the windows of a sweep to every pixel's place by maximum likelihood: noise, footprints, fit, honest uncertainty."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.stats import chi2

from recon.sessions.manifest import StripePattern
from recon.sweeps.curve_samples import CurveSamples, SweepCurves
from recon.sweeps.curve_table import CurveTable, curve_table
from recon.sweeps.footprint import coordinate_gradient
from recon.sweeps.map_scatter import scatter_beyond_px
from recon.sweeps.noise import NoiseModel, lone_peak_variance, noise_from_residuals
from recon.sweeps.stripe_fit import StripeFit, WidthPrior, fit_stripe, leverage_of, looked_up
from recon.sweeps.stripe_peak import PeakWindows
from recon.sweeps.two_paths import TwoPaths, two_paths, unresolved_px
from recon.sweeps.width_prior import GRADIENT_SD, Footprints, known_prior, neighbours_prior

# Every third pixel in each direction tells noise and widths of all.
LATTICE_PX = 3
FEW_PIXELS = 20_000
# The variance of a sample that the fit bends itself to cannot be read from its residual.
LARGEST_LEVERAGE = 0.8
# A curve whose misfit is a quarter of its height is not that of one stripe.
LARGEST_MISFIT = 0.25
# One good curve in a thousand is taken for a bad one, whose own misfit then widens its sd.
OWN_MISFIT_CHANCE = 1e-3
# A curve still this high, as a share of its peak, at an end of its window shows one flank alone: its centre lies anywhere.
CUT_OFF_LEVEL = 0.5
SCALE_WINDOW_PX = 11
LARGEST_CLEAN_RATIO = 4.0
# The part of a curve above this share of its peak tells its centre.
CENTRE_LEVEL = 0.1
BLUR_PIXELS = 2000
BLUR_SPACING = 0.35
OCCAM_SHARE = 0.03
THINNEST_PX = 0.05
SHARP_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodPlaces:
    """The fit of the pixels listed in ``pixels``, what it rests on, and which of them are ``good``.

    ``two`` are those of them that the stripe lit twice; ``fit`` holds their brighter path.
    """

    pixels: Int64[np.ndarray, " pixels"]
    fit: StripeFit
    prior: WidthPrior
    table: CurveTable
    noise: NoiseModel
    good: Bool[np.ndarray, " pixels"]
    two: TwoPaths

    def drawn(self, row: int, peak: int) -> Float64[np.ndarray, " samples"]:
        """Return the fitted curve of the pixel in ``row`` of the list, in counts above black, about its stripe ``peak``."""
        pattern, count = self.table.pattern, 2 * (self.table.pad - 1) + 1
        samples = CurveSamples(
            height=np.zeros((1, count), dtype=np.float32),
            usable=np.ones((1, count), dtype=bool),
            peak=np.array([peak]),
            peak_px=np.array([pattern.first_px + pattern.step_px * peak]),
        )
        one = slice(row, row + 1)
        shape = self.prior.shape[one]
        curve, _, _ = looked_up(samples, self.fit.place_px[one], self.fit.log_width[one], shape=shape, table=self.table)
        return self.fit.background[row] + self.fit.amplitude[row] * curve[0].astype(np.float64)


def places_by_likelihood(
    windows: PeakWindows,
    pixels: Int64[np.ndarray, " pixels"],
    pattern: StripePattern,
    *,
    black: np.ndarray,
    dark_variance: float,
    clipped: int,
    continuous: bool,
) -> LikelihoodPlaces:
    """Fit the curve of every listed pixel.

    Parameters
    ----------
    windows, pixels
        The samples about each pixel's peak, and the pixels (row · columns + column) that have one.
    black
        Counts without the stripe [rows, cols].
    dark_variance, clipped
        Variance of a dark sample in counts squared; the first clipped count.
    continuous
        The stripe was drawn as a function and not on device pixels.

    Notes
    -----
    Noise and widths come from an even lattice of pixels, fitted twice: first with the dark noise alone, then with what
    that told. All pixels are fitted once, with their neighbours' widths as a prior.
    """
    table = curve_table(pattern, half_width=windows.half_width, continuous=continuous)
    curves = SweepCurves(windows, table, black.ravel(), clipped)
    start = _centres(windows, pixels, pattern, black=black)
    box_px = _boxes(start, pixels, black.shape, quantum_px=pattern.step_px if continuous else max(pattern.step_px, 1.0))
    some = _lattice(pixels, black.shape)
    noise = NoiseModel(dark_variance)
    lone = lone_peak_variance(windows, black, clipped=clipped, dark_variance=dark_variance)
    # What is taken for blur depends on the noise, and what for noise on the blur: twice round is enough.
    for _ in range(2):
        footprints = Footprints(box_px, _common_blur_px(curves, pixels, box_px, noise=noise))
        prior = known_prior(footprints, sd=GRADIENT_SD)
        fit = fit_stripe(curves, pixels[some], prior.some(some), noise=noise)
        noise = _noise(
            curves, pixels[some], fit, prior.some(some), before=noise, dark_variance=dark_variance, lone=lone
        )
    prior = neighbours_prior(fit, some, footprints, pixels, grid=black.shape)
    fit = fit_stripe(curves, pixels, prior, noise=noise)
    unresolved = unresolved_px(fit, prior)
    two = two_paths(curves, pixels, prior, noise=noise)
    two = two.some(_good(two.first, pattern, noise=noise) & _good(two.second, pattern, noise=noise))
    for name in StripeFit.__slots__:
        getattr(fit, name)[two.rows] = getattr(two.first, name)
    cut_off = _cut_off(curves, pixels)
    # The other peak may reach into the window's end, and its light has been taken away.
    unresolved[two.rows], cut_off[two.rows] = 0.0, False
    good = _good(fit, pattern, noise=noise) & ~cut_off
    fit.sd_px[:] = np.hypot(fit.sd_px * _misfit_scale(fit, pixels, good, black.shape), unresolved)
    two.second.sd_px[:] *= np.sqrt(np.maximum(two.second.chi_square / two.second.freedom, 1.0))
    place_map, sd_map = np.full((2, *black.shape), np.nan)
    place_map.ravel()[pixels[good]], sd_map.ravel()[pixels[good]] = fit.place_px[good], fit.sd_px[good]
    beyond_px = scatter_beyond_px(place_map, sd_map)
    for sd_px in (fit.sd_px, two.second.sd_px):
        sd_px[:] = np.hypot(sd_px, beyond_px)
    return LikelihoodPlaces(pixels, fit, prior, table, noise, good, two)


def _good(fit: StripeFit, pattern: StripePattern, *, noise: NoiseModel) -> Bool[np.ndarray, " pixels"]:
    """Tell which curves are those of one stripe whose place they say."""
    residual_rms = np.sqrt(fit.chi_square / (fit.freedom + 3) * noise.variance(fit.amplitude / 2))
    # A place known no better than the stripe's own width says nothing.
    vague = ~(fit.sd_px < max(pattern.width_px, pattern.step_px))
    return (residual_rms <= LARGEST_MISFIT * fit.amplitude) & (fit.amplitude > 0) & ~vague


def _centres(
    windows: PeakWindows, pixels: np.ndarray, pattern: StripePattern, *, black: np.ndarray
) -> Float64[np.ndarray, " pixels"]:
    """Return a first guess of the place in device pixels: the centre of mass of each curve about its peak."""
    height = windows.samples[pixels].astype(np.float32) - black.ravel()[pixels, None].astype(np.float32)
    peak = height[:, windows.half_width, None]
    height = np.where(windows.inside()[pixels] & (height > CENTRE_LEVEL * peak), height, np.float32(0))
    offset = np.arange(-windows.half_width, windows.half_width + 1, dtype=np.float32)
    mean = (height @ offset) / np.maximum(height.sum(axis=1, dtype=np.float64), 1e-9)
    return (pattern.first_px + pattern.step_px * (windows.peak_index[pixels] + mean)).astype(np.float64)


def _cut_off(curves: SweepCurves, pixels: np.ndarray) -> Bool[np.ndarray, " pixels"]:
    """Return which curves are not down at an end of their window that lies within the sweep."""
    windows = curves.windows
    height = windows.samples[pixels].astype(np.float32) - curves.black[pixels, None].astype(np.float32)
    peak = height[:, windows.half_width]
    ends = windows.inside()[pixels][:, [0, -1]] & (height[:, [0, -1]] > CUT_OFF_LEVEL * peak[:, None])
    return ends.any(axis=1)


def _common_blur_px(curves: SweepCurves, pixels: np.ndarray, box_px: np.ndarray, *, noise: NoiseModel) -> float:
    """Return the blur beyond the boxes that explains an even sample of the curves best, trying all that a window can tell.

    Fits with a free width would be drawn towards wide ones: two lit samples tell their ratio alone.
    """
    some = np.arange(0, len(pixels), max(len(pixels) // BLUR_PIXELS, 1))
    unit = min(curves.table.pattern.step_px, 1.0)
    ladder = np.exp(np.arange(np.log(THINNEST_PX * unit), curves.table.log_width[-1], BLUR_SPACING))
    # Even a faint tail of a blur would forbid places at the ends of an interval.
    blurs = np.concatenate([[SHARP_PX * unit], ladder])
    if len(some) == 0:
        return float(blurs[0])
    misfit = []
    for blur in blurs:
        prior = known_prior(Footprints(box_px[some], float(blur)), sd=0.01)
        fit = fit_stripe(curves, pixels[some], prior, noise=noise)
        # The logarithm keeps curves that no blur explains from deciding.
        misfit.append(float(np.log1p(fit.chi_square / fit.freedom).sum()))
    # The least blur that explains the curves nearly as well as the best: too wide a footprint makes places look too sure.
    near = np.array(misfit) <= min(misfit) + OCCAM_SHARE * len(some)
    return float(blurs[np.argmax(near)])


def _boxes(place: np.ndarray, pixels: np.ndarray, grid: tuple[int, int], *, quantum_px: float) -> np.ndarray:
    """Return the widths of the two boxes of each pixel's footprint: the gradient of the map of places."""
    place_map = np.full(grid, np.nan)
    place_map.ravel()[pixels] = place
    gradient = coordinate_gradient(place_map, np.isfinite(place_map), quantum_px=quantum_px)
    widths = np.abs(gradient).reshape(-1, 2)[pixels]
    known = np.isfinite(widths).all(axis=1)
    typical = np.median(widths[known], axis=0) if known.any() else np.array([0.5, 0.5])
    return np.where(known[:, None], widths, typical)


def _lattice(pixels: np.ndarray, grid: tuple[int, int]) -> Int64[np.ndarray, " some"]:
    """Return which of the listed pixels are fitted first: an even lattice, or all where there are few."""
    if len(pixels) <= FEW_PIXELS:
        return np.arange(len(pixels))
    row, col = np.divmod(pixels, grid[1])
    return np.flatnonzero((row % LATTICE_PX == 0) & (col % LATTICE_PX == 0))


def _noise(
    curves: SweepCurves,
    pixels: np.ndarray,
    fit: StripeFit,
    prior: WidthPrior,
    *,
    before: NoiseModel,
    dark_variance: float,
    lone: tuple[float, float] | None,
) -> NoiseModel:
    """Read the noise from what the fit left, each residual divided by what the fit took of it."""
    if len(pixels) == 0:
        return before
    samples = curves.samples(pixels)
    lit, residual, leverage = leverage_of(samples, fit, prior, table=curves.table, noise=before)
    used = samples.usable & (leverage < LARGEST_LEVERAGE)
    return noise_from_residuals(
        lit[used],
        residual[used] / np.sqrt(1 - leverage[used]),
        read_variance=dark_variance,
        freedom_share=1.0,
        more=lone,
    )


def _misfit_scale(
    fit: StripeFit, pixels: np.ndarray, good: np.ndarray, grid: tuple[int, int]
) -> Float64[np.ndarray, " pixels"]:
    """Return by how much each sd is widened, because curves are not quite the model's (Birge's ratio).

    The ratio of the neighbourhood counts, whose own scatter is small; a pixel's own one does where chance does not explain it.
    """
    ratio = fit.chi_square / fit.freedom
    clean = np.zeros(grid)
    count = np.zeros(grid)
    clean.ravel()[pixels[good]] = np.minimum(ratio[good], LARGEST_CLEAN_RATIO)
    count.ravel()[pixels[good]] = 1.0
    window = (SCALE_WINDOW_PX, SCALE_WINDOW_PX)
    total, number = (
        cv2.boxFilter(one, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for one in (clean, count)
    )
    local = np.maximum((total / np.maximum(number, 1.0)).ravel()[pixels], 1.0)
    own = np.where(fit.chi_square > local * chi2.isf(OWN_MISFIT_CHANCE, fit.freedom), ratio, 0.0)
    return np.sqrt(np.maximum(local, own))
