"""Pixels that the stripe lights twice in a sweep: two light paths reach the camera together, each with a place of its own.

So it is at the rim of an object, where half a pixel looks past it, and where light is refracted twice or reflected inside. Both
curves are fitted, each with the other's light taken away, and the two places are never averaged.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, Int32, Int64

from recon.sweeps.curve_lookup import looked_up
from recon.sweeps.curve_samples import SweepCurves
from recon.sweeps.curve_table import CurveTable
from recon.sweeps.noise import NoiseModel
from recon.sweeps.stripe_fit import StripeFit, WidthPrior, fit_stripe
from recon.sweeps.stripe_peak import NO_PEAK, PeakWindows, SecondPeaks

# A second peak is one that noise alone would show in one sample of a thousand million.
SECOND_SIGMA = 6.0
# Glare, and the ringing of compressed photos, show a pixel some percent of the light that its neighbours get.
LEAST_SHARE = 0.05
# Two maxima are two peaks where the curve falls to half of the lesser one between them.
VALLEY_SHARE = 0.5
# The second path has a footprint of its own, of which the neighbours say little: the sd of its width's logarithm.
SECOND_WIDTH_SD = 1.0
ROUNDS = 3
# One pixel in thirty thousand is taken for one with two peaks in one because its curve happens to be wide.
WIDE_SIGMA = 4.0
# A curve that holds less than this share of what was known of its width says nothing of it: steps of the walk that are too small
# to matter would be many of its standard deviations.
LEAST_INFORMATION = 0.03
# Stands for a sample that no fit may use, beyond any count.
LEFT_OUT = 1 << 30


@dataclass(frozen=True, slots=True, eq=False)
class TwoPaths:
    """Which ``rows`` of a list of pixels have two peaks, and the fits of the brighter path (``first``) and of the other."""

    rows: Int64[np.ndarray, " two"]
    first: StripeFit
    second: StripeFit

    def some(self, those: Bool[np.ndarray, " two"]) -> "TwoPaths":
        """Return some of the pixels."""
        first, second = (
            StripeFit(*(getattr(fit, name)[those] for name in StripeFit.__slots__)) for fit in (self.first, self.second)
        )
        return TwoPaths(self.rows[those], first, second)


@dataclass(frozen=True, slots=True, eq=False)
class _Peak:
    """One of two peaks in each pixel: its stripe number, the counts above black about it, and which of these may be used."""

    number: Int32[np.ndarray, " two"]
    height: Float32[np.ndarray, "two samples"]
    usable: Bool[np.ndarray, "two samples"]

    def stripes(self) -> np.ndarray:
        """Return the stripe numbers [two, samples] of the samples."""
        half_width = self.height.shape[1] // 2
        return self.number[:, None] + np.arange(-half_width, half_width + 1)

    def some(self, rows: np.ndarray) -> "_Peak":
        """Return the peaks of some of the pixels."""
        return _Peak(self.number[rows], self.height[rows], self.usable[rows])


def two_paths(
    curves: SweepCurves, pixels: Int[np.ndarray, " pixels"], prior: WidthPrior, *, noise: NoiseModel
) -> TwoPaths:
    """Fit both peaks of the listed pixels that have two; whether a fit is good is for the caller to judge.

    The peaks are first fitted to the samples nearer to them than to the other, then each to what the other's curve leaves.
    """
    nothing = StripeFit(*(np.empty(0) for _ in StripeFit.__slots__))
    windows, beyond = curves.windows, curves.windows.second
    if beyond is None:
        return TwoPaths(np.empty(0, dtype=np.int64), nothing, nothing)
    rows = _risen(curves, beyond, pixels, noise=noise)
    risen = pixels[rows]
    one, other = (
        _peak(curves, windows, risen, pixels=risen),
        _peak(curves, beyond.windows, beyond.rows_of(risen), pixels=risen),
    )
    apart = _valley(one, other, photo_count=windows.photo_count, noise=noise)
    rows, one, other = rows[apart], one.some(apart), other.some(apart)
    if len(rows) == 0:
        return TwoPaths(rows, nothing, nothing)
    narrow = prior.some(rows)
    wide = WidthPrior(narrow.shape, narrow.log_width, np.full(len(rows), SECOND_WIDTH_SD))

    def fit(peak: _Peak, width: WidthPrior) -> StripeFit:
        return _fit(peak, width, table=curves.table, photo_count=windows.photo_count, noise=noise)

    first, second = fit(_nearer(one, other), narrow), fit(_nearer(other, one), wide)
    for _ in range(ROUNDS):
        lit = (
            _light(one, first, narrow.shape, table=curves.table),
            _light(other, second, wide.shape, table=curves.table),
        )
        first, second = fit(_without(one, other, lit[1]), narrow), fit(_without(other, one, lit[0]), wide)
    # Beside a bright stripe compressed photos are noisier than elsewhere: what the fit leaves tells how noisy.
    top = _light(other, second, wide.shape, table=curves.table).max(axis=1)
    noise_sd = np.sqrt(noise.read_variance * np.maximum(second.chi_square / second.freedom, 1.0))
    # The brightest sample may belong to the path with less light, where that one's footprint is the smaller.
    swapped = second.amplitude > first.amplitude
    brighter, lesser = (
        StripeFit(*(np.where(swapped, getattr(b, name), getattr(a, name)) for name in StripeFit.__slots__))
        for a, b in ((first, second), (second, first))
    )
    return TwoPaths(rows, brighter, lesser).some(top >= SECOND_SIGMA * noise_sd)


def rows_seen_twice(windows: PeakWindows, pixels: Int[np.ndarray, " pixels"]) -> Int64[np.ndarray, " some"]:
    """Return which of the listed pixels, in ascending order, have a second maximum, be it noise or light."""
    if windows.second is None or not len(pixels):
        return np.empty(0, dtype=np.int64)
    rows = np.minimum(np.searchsorted(pixels, windows.second.pixels), len(pixels) - 1)
    return rows[pixels[rows] == windows.second.pixels]


def unresolved_px(fit: StripeFit, prior: WidthPrior) -> Float64[np.ndarray, " pixels"]:
    """Return how far two light paths whose peaks are one may be from the middle of both: by what a curve is wider than its
    neighbours say, where that is no chance; else 0.

    Peaks with shares p and 1 − p at a distance s have the variance p(1 − p)s², which is the mean square distance from the middle
    to either, and adds to the footprint's own. Two peaks are no Gaussian, whose fitted width is then up to half too large.
    """
    unresolved = np.zeros(len(fit.log_width))
    # Few are wider by enough of the prior's standard deviations for any curve that says something to be no chance.
    least = WIDE_SIGMA * np.sqrt(LEAST_INFORMATION / (1 + LEAST_INFORMATION))
    some = np.flatnonzero(fit.log_width - prior.log_width > least * prior.sd)
    log_width, known = fit.log_width[some], prior.log_width[some]
    own, precision = np.maximum(fit.width_information[some], 1e-12), 1 / prior.sd[some] ** 2
    # What the curve alone says of its width differs from the prior by this many of its standard deviations.
    sigma = (log_width - known) * np.sqrt((own + precision) * precision / own)
    wide = (sigma > WIDE_SIGMA) & (own > LEAST_INFORMATION * precision)
    unresolved[some[wide]] = np.sqrt(np.exp(2 * log_width[wide]) - np.exp(2 * known[wide]))
    return unresolved


def _risen(
    curves: SweepCurves, second: SecondPeaks, pixels: np.ndarray, *, noise: NoiseModel
) -> Int64[np.ndarray, " risen"]:
    """Return the rows of the pixels whose second maximum is neither noise nor glare, and inside the sweep."""
    row = second.rows_of(pixels)
    some = np.flatnonzero(row != NO_PEAK)
    these, row = pixels[some], row[some]
    first, windows = curves.windows, second.windows
    middle = windows.half_width
    black = curves.black[these].astype(np.float32)
    first_top = first.samples[these, middle].astype(np.float32) - black
    top = windows.samples[row, middle].astype(np.float32) - black
    number = windows.peak_index[row]
    inside = (number > 0) & (number < windows.photo_count - 1)
    least = np.maximum(SECOND_SIGMA * np.sqrt(noise.read_variance), LEAST_SHARE * first_top)
    return some[inside & (top >= least)]


def _peak(curves: SweepCurves, windows: PeakWindows, rows: np.ndarray, *, pixels: np.ndarray) -> _Peak:
    """Return the peaks in some rows of the windows, which are those of ``pixels``."""
    counts, number = windows.samples[rows], windows.peak_index[rows]
    height = counts.astype(np.float32) - curves.black[pixels].astype(np.float32)[:, None]
    return _Peak(number, height, (counts < curves.clipped) & _exists(number, windows))


def _exists(number: np.ndarray, windows: PeakWindows) -> np.ndarray:
    """Tell which samples lie inside the sweep."""
    stripes = number[:, None] + np.arange(-windows.half_width, windows.half_width + 1)
    return (stripes >= 0) & (stripes < windows.photo_count)


def _valley(one: _Peak, other: _Peak, *, photo_count: int, noise: NoiseModel) -> Bool[np.ndarray, " pixels"]:
    """Tell which second maxima are no part of the first: the curve falls far below them on the way to it."""
    top = other.height[:, other.height.shape[1] // 2]
    stripes = other.stripes()
    between = (stripes - one.number[:, None]) * (stripes - other.number[:, None]) < 0
    valley = np.where(between & (stripes >= 0) & (stripes < photo_count), other.height, np.inf).min(
        axis=1, initial=np.inf
    )
    # The valley's own noise must not close it.
    return valley <= VALLEY_SHARE * top + np.sqrt(noise.variance(top))


def _nearer(peak: _Peak, other: _Peak) -> _Peak:
    """Return a peak with only the samples that are nearer to it than to the other."""
    stripes = peak.stripes()
    nearer = np.abs(stripes - peak.number[:, None]) < np.abs(stripes - other.number[:, None])
    return _Peak(peak.number, peak.height, peak.usable & nearer)


def _light(peak: _Peak, fit: StripeFit, shape: np.ndarray, *, table: CurveTable) -> Float32[np.ndarray, "two samples"]:
    """Return the counts that one path alone gives at its own samples."""
    samples = _curves(peak, table=table, photo_count=LEFT_OUT).samples(np.arange(len(peak.number)))
    curve, _, _ = looked_up(samples, fit.place_px, fit.log_width, shape=shape, table=table)
    return (fit.amplitude[:, None] * curve).astype(np.float32)


def _without(peak: _Peak, other: _Peak, light: np.ndarray) -> _Peak:
    """Return a peak without the other's ``light``, which is that at the other's own samples."""
    count = light.shape[1]
    column = peak.stripes() - other.number[:, None] + count // 2
    shared = (column >= 0) & (column < count)
    taken = np.where(shared, np.take_along_axis(light, np.clip(column, 0, count - 1), axis=1), np.float32(0))
    return _Peak(peak.number, peak.height - taken, peak.usable)


def _curves(peak: _Peak, *, table: CurveTable, photo_count: int) -> SweepCurves:
    samples = np.where(peak.usable, peak.height, np.float32(LEFT_OUT))
    windows = PeakWindows(peak.number, samples, peak.height.shape[1] // 2, photo_count)
    return SweepCurves(windows, table, np.zeros(len(samples), dtype=np.float32), LEFT_OUT)


def _fit(peak: _Peak, prior: WidthPrior, *, table: CurveTable, photo_count: int, noise: NoiseModel) -> StripeFit:
    curves = _curves(peak, table=table, photo_count=photo_count)
    return fit_stripe(curves, np.arange(len(peak.number), dtype=np.int64), prior, noise=noise)
