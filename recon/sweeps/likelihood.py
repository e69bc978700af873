"""From the windows of a sweep to every pixel's place by maximum likelihood: noise, footprints, fit, honest uncertainty."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int

from recon.compiled import compiled
from recon.memory import give_back_free_memory
from recon.sessions.manifest import StripePattern
from recon.sweeps.centre_places import centre_shifts
from recon.sweeps.curve_fits import CurveFits, good_fit, prepared_fits
from recon.sweeps.curve_samples import SweepCurves
from recon.sweeps.curve_table import curve_table
from recon.sweeps.fitted_pixels import keep_second_paths, laid, nothing_fitted
from recon.sweeps.map_scatter import scatter_beyond
from recon.sweeps.misfit import widen_by_misfit
from recon.sweeps.neighbour_places import told_by_neighbours
from recon.sweeps.stripe_fit import angular_log_width
from recon.sweeps.stripe_peak import PeakWindows
from recon.sweeps.two_paths import rows_seen_twice, unresolved_px

# Fitted and written into the maps at a time: what is made of them is small beside the maps of a large photo.
PIXELS_AT_ONCE = 1 << 16
# A curve still this high, as a share of its peak, at an end of its window shows one flank alone: its centre lies anywhere.
CUT_OFF_LEVEL = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodPlaces:
    """Maps of the places and of their sds in device pixels, NaN where there is no good fit, and the fits behind them.

    The stripe lit the pixels ``twice``; ``second_px`` and ``second_sd_px`` are those of the path with less light. ``light`` is
    the fitted amplitude of each listed pixel, and ``misfit`` the median of chi-square over degrees of freedom.
    """

    place_px: Float32[np.ndarray, "rows cols"]
    sd_px: Float32[np.ndarray, "rows cols"]
    twice: Int[np.ndarray, " twice"]
    second_px: Float64[np.ndarray, " twice"]
    second_sd_px: Float64[np.ndarray, " twice"]
    light: Float32[np.ndarray, " pixels"]
    misfit: float
    fits: CurveFits


def places_by_likelihood(
    windows: PeakWindows,
    pixels: Int[np.ndarray, " pixels"],
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
        The samples about each pixel's peak, and the pixels (row · columns + column) that have one, in ascending order.
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
    fits = prepared_fits(curves, pixels, grid=black.shape, dark_variance=dark_variance)
    give_back_free_memory()
    fitted = nothing_fitted(fits, black.shape)
    reach_px = np.full(len(pixels), np.nan, dtype=np.float16)
    merged, merged_by_px = [pixels[:0]], [np.empty(0, dtype=np.float32)]
    for low in range(0, len(pixels), PIXELS_AT_ONCE):
        rows = slice(low, low + PIXELS_AT_ONCE)
        fit, prior = fits.fit(rows)
        fitted.keep(rows, fit, good_fit(fit, pattern, noise=fits.noise) & ~_cut_off(curves, pixels[rows]))
        unsure_px = unresolved_px(fit, prior)
        unsure = np.flatnonzero(unsure_px)
        merged.append(pixels[rows][unsure])
        merged_by_px.append(unsure_px[unsure].astype(np.float32))
        flat = prior.log_width < angular_log_width(table)
        reach_px[rows][flat] = fits.footprints.box_px[rows][flat].sum(axis=1)
    second = keep_second_paths(fitted, rows_seen_twice(windows, pixels), at_once=PIXELS_AT_ONCE)
    give_back_free_memory()
    usual_misfit, light = fitted.usual_misfit(), fitted.light
    place_px, sd_px, width_px = fitted.place_px, fitted.sd_px, fitted.width_px
    widen_by_misfit(sd_px, fitted.misfit, fitted.freedom, pixels)
    del fitted
    unresolved = np.concatenate(merged)
    alone = ~np.isin(unresolved, second.pixels)
    unresolved = unresolved[alone]
    sd_px.ravel()[unresolved] = np.hypot(sd_px.ravel()[unresolved], np.concatenate(merged_by_px)[alone])
    width_px = laid(width_px, pixels, slice(0, len(black)), columns=black.shape[1])
    beyond = scatter_beyond(place_px, sd_px, width_px)
    width_px *= np.float32(beyond)
    np.hypot(sd_px, width_px, out=sd_px)
    del width_px
    trusted = np.ones(black.shape, dtype=bool)
    trusted.ravel()[second.pixels] = trusted.ravel()[unresolved] = False
    reach_map_px = np.full(black.shape, np.nan, dtype=np.float16)
    reach_map_px.ravel()[pixels] = reach_px
    place_px, sd_px = told_by_neighbours(place_px, sd_px, trusted=trusted, reach_px=reach_map_px)
    del reach_map_px
    if not continuous:
        shift_px, doubt_px = centre_shifts(place_px, sd_px, trusted, pixels, light, pattern=pattern, noise=fits.noise)
        place_px -= shift_px
        np.hypot(sd_px, doubt_px, out=sd_px)
    return LikelihoodPlaces(
        place_px=place_px,
        sd_px=sd_px,
        twice=second.pixels,
        second_px=second.place_px,
        second_sd_px=np.hypot(second.sd_px, beyond * second.width_px),
        light=light,
        misfit=usual_misfit,
        fits=fits,
    )


def _cut_off(curves: SweepCurves, pixels: np.ndarray) -> Bool[np.ndarray, " pixels"]:
    """Return which curves are not down at an end of their window that lies within the sweep."""
    windows = curves.windows
    cut_off = np.empty(len(pixels), dtype=bool)
    write_cut_off(pixels, windows.samples, windows.peak_index, curves.black, windows.photo_count, cut_off)
    return cut_off


@compiled
def write_cut_off(
    pixels: np.ndarray,
    samples: np.ndarray,
    peak_index: np.ndarray,
    black: np.ndarray,
    photo_count: int,
    cut_off: np.ndarray,
) -> None:
    """Write which of some pixels' windows of counts are too high at an end that lies within the sweep."""
    last = samples.shape[1] - 1
    half = last // 2
    for number in range(len(pixels)):
        pixel = np.uintp(pixels[number])
        dark, middle = float(black[pixel]), peak_index[pixel]
        level = CUT_OFF_LEVEL * (samples[pixel, half] - dark)
        before = middle >= half and samples[pixel, 0] - dark > level
        after = middle < photo_count - half and samples[pixel, last] - dark > level
        cut_off[number] = before or after
