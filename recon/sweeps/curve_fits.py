"""The fits of a sweep's curves, once an even lattice of the pixels has told how noisy they are and how wide."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, Int64

from recon.compiled import compiled
from recon.sessions.manifest import StripePattern
from recon.sweeps.curve_centres import curve_centres
from recon.sweeps.curve_lookup import looked_up
from recon.sweeps.curve_samples import SweepCurves
from recon.sweeps.footprint import coordinate_gradient
from recon.sweeps.leverage import leverage_of
from recon.sweeps.noise import NoiseModel, noise_from_residuals
from recon.sweeps.peak_noise import beside_peak_variance, lone_peak_variance
from recon.sweeps.stripe_fit import PIXELS_A_BLOCK, StripeFit, WidthPrior, fit_stripe
from recon.sweeps.stripe_model import LARGEST_MISFIT
from recon.sweeps.two_paths import TwoPaths, two_paths
from recon.sweeps.width_prior import EVEN_SD, GRADIENT_SD, Footprints, NeighbourWidths, known_prior, neighbour_widths

# Every third pixel in each direction tells noise and widths of all.
LATTICE_PX = 3
FEW_PIXELS = 20_000
# More of them would tell the noise no better.
NOISE_PIXELS = 100_000
# The variance of a sample that the fit bends itself to cannot be read from its residual.
LARGEST_LEVERAGE = 0.8
# The median width of so many pixels is that of all.
MEDIAN_PIXELS = 1 << 20
BLUR_PIXELS = 2000
BLUR_SPACING = 0.35
OCCAM_SHARE = 0.03
THINNEST_PX = 0.05
SHARP_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class CurveFits:
    """Fits the curves of the listed pixels, once it is known how noisy they are and how wide.

    ``footprints`` are those of the listed pixels.
    """

    curves: SweepCurves
    pixels: Int[np.ndarray, " pixels"]
    footprints: Footprints
    widths: NeighbourWidths
    noise: NoiseModel

    def fit(self, rows: np.ndarray | slice) -> tuple[StripeFit, WidthPrior]:
        """Fit some rows of the list as if the stripe lit each pixel once."""
        prior = self.prior(rows)
        return fit_stripe(self.curves, self.pixels[rows], prior, noise=self.noise), prior

    def fit_two(self, rows: Int[np.ndarray, " some"]) -> TwoPaths:
        """Fit some rows of the list that may have been lit twice; ``rows`` of the result, which were, are those of the list."""
        pattern, noise = self.curves.table.pattern, self.noise
        two = two_paths(self.curves, self.pixels[rows], self.prior(rows), noise=noise)
        two = two.some(good_fit(two.first, pattern, noise=noise) & good_fit(two.second, pattern, noise=noise))
        return TwoPaths(rows[two.rows], two.first, two.second)

    def prior(self, rows: np.ndarray | slice) -> WidthPrior:
        """Return what is known of the widths of some rows of the list."""
        return self.widths.prior(self.footprints.some(rows), self.pixels[rows])

    def drawn(self, pixels: Int[np.ndarray, " some"]) -> Float64[np.ndarray, "some samples"]:
        """Return the fitted curves [pixels, samples] of some of the pixels, in counts above black; of two paths the brighter."""
        rows = np.searchsorted(self.pixels, pixels)
        fit, prior = self.fit(rows)
        two = self.fit_two(rows)
        for name in StripeFit.__slots__:
            getattr(fit, name)[np.searchsorted(rows, two.rows)] = getattr(two.first, name)
        samples = self.curves.samples(pixels)
        curve, _, _ = looked_up(samples, fit.place_px, fit.log_width, shape=prior.shape, table=self.curves.table)
        return fit.background[:, None] + fit.amplitude[:, None] * curve


def good_fit(fit: StripeFit, pattern: StripePattern, *, noise: NoiseModel) -> Bool[np.ndarray, " pixels"]:
    """Tell which curves are those of one stripe whose place they say."""
    residual_rms = np.sqrt(fit.chi_square / (fit.freedom + 3) * noise.variance(fit.amplitude / 2))
    # A place known no better than the stripe's own width says nothing.
    vague = ~(fit.sd_px < max(pattern.width_px, pattern.step_px))
    return (residual_rms <= LARGEST_MISFIT * fit.amplitude) & (fit.amplitude > 0) & ~vague


def prepared_fits(
    curves: SweepCurves,
    pixels: Int[np.ndarray, " pixels"],
    *,
    grid: tuple[int, int],
    dark_variance: float,
) -> CurveFits:
    """Learn noise, blur and widths from an even lattice of the pixels."""
    black = curves.black.reshape(grid)
    box_px, box_sd = _boxes(curves, curve_centres(curves, pixels, grid=grid), pixels)
    some, spacing = _lattice(pixels, grid)
    few = slice(None, None, max(len(some) // NOISE_PIXELS, 1))
    dark_variance = max(dark_variance, beside_peak_variance(curves.windows, curves.black) or 0.0)
    noise = NoiseModel(dark_variance)
    lone = lone_peak_variance(curves.windows, black, clipped=curves.clipped, dark_variance=dark_variance)
    # What is taken for blur depends on the noise, and what for noise on the blur: twice round is enough.
    for of in (some[few], some):
        footprints = Footprints(box_px, box_sd, _common_blur_px(curves, pixels, box_px, noise=noise))
        prior = known_prior(footprints.some(of))
        fit = fit_stripe(curves, pixels[of], prior, noise=noise)
        told = few if of is some else slice(None)
        noise = _noise(
            curves,
            pixels[of][told],
            fit.some(told),
            prior.some(told),
            before=noise,
            dark_variance=dark_variance,
            lone=lone,
        )
    widths = neighbour_widths(fit, footprints.some(some), pixels[some], grid=grid, spacing=spacing)
    return CurveFits(curves, pixels, footprints, widths, noise)


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
    misfit, sure = [], np.zeros(len(some), np.float32)
    for blur in blurs:
        prior = known_prior(Footprints(box_px[some], sure, float(blur)), sd=0.01)
        fit = fit_stripe(curves, pixels[some], prior, noise=noise)
        # The logarithm keeps curves that no blur explains from deciding.
        misfit.append(float(np.log1p(fit.chi_square / fit.freedom).sum()))
    # The least blur that explains the curves nearly as well as the best: too wide a footprint makes places look too sure.
    near = np.array(misfit) <= min(misfit) + OCCAM_SHARE * len(some)
    return float(blurs[np.argmax(near)])


def _boxes(
    curves: SweepCurves, place_px: Float32[np.ndarray, "rows cols"], pixels: np.ndarray
) -> tuple[Float32[np.ndarray, "pixels 2"], Float32[np.ndarray, " pixels"]]:
    """Return the widths of the two boxes of each listed pixel's footprint, from the map's gradient, and their relative sd."""
    table = curves.table
    quantum_px = table.pattern.step_px if table.continuous else max(table.pattern.step_px, 1.0)
    gradient, even = coordinate_gradient(place_px, np.isfinite(place_px), quantum_px=quantum_px)
    widths, known = np.empty((len(pixels), 2), dtype=gradient.dtype), np.empty(len(pixels), dtype=bool)
    write_widths(pixels, gradient.reshape(-1, 2), widths, known)
    if not known.all():
        few = np.flatnonzero(known)
        few = few[:: max(len(few) // MEDIAN_PIXELS, 1)]
        widths[~known] = np.median(widths[few], axis=0) if len(few) else 0.5
    return widths, np.where(even.ravel()[pixels], EVEN_SD, GRADIENT_SD)


@compiled
def write_widths(pixels: np.ndarray, gradient: np.ndarray, widths: np.ndarray, known: np.ndarray) -> None:
    """Write the magnitudes of a gradient [all pixels, 2] at the listed pixels, and where there is one."""
    for number in range(np.uintp(len(pixels))):
        pixel = np.uintp(pixels[number])
        by_col, by_row = gradient[pixel, 0], gradient[pixel, 1]
        widths[number, 0], widths[number, 1] = abs(by_col), abs(by_row)
        # A gradient has both of its parts or neither.
        known[number] = not np.isnan(by_col)


def _lattice(pixels: np.ndarray, grid: tuple[int, int]) -> tuple[Int64[np.ndarray, " some"], int]:
    """Return which of the listed pixels are fitted first, and their spacing: an even lattice, or all where there are few."""
    if len(pixels) <= FEW_PIXELS:
        return np.arange(len(pixels)), 1
    lattice = np.zeros(grid, dtype=bool)
    lattice[::LATTICE_PX, ::LATTICE_PX] = True
    return np.flatnonzero(lattice.ravel()[pixels]), LATTICE_PX


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
    signals, residuals = [], []
    for low in range(0, len(pixels), PIXELS_A_BLOCK):
        rows = slice(low, low + PIXELS_A_BLOCK)
        samples = curves.samples(pixels[rows])
        lit, residual, leverage = leverage_of(
            samples, fit.some(rows), prior.some(rows), table=curves.table, noise=before
        )
        used = samples.usable & (leverage < LARGEST_LEVERAGE)
        signals.append(lit[used])
        residuals.append(residual[used] / np.sqrt(1 - leverage[used]))
    return noise_from_residuals(
        np.concatenate(signals),
        np.concatenate(residuals),
        read_variance=dark_variance,
        freedom_share=1.0,
        more=lone,
    )
