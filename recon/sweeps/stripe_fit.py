"""Maximum-likelihood place of the stripe in each pixel's intensity curve, with its standard deviation.

The model is ``height = background + amplitude · m(place − stripe; width)`` with the curves m of ``curve_table.py``. Amplitude
and background are linear and solved for at every step; place and logarithm of the width are walked by Gauss–Newton from the
best place of a scan (``stripe_scan.py``). What is known of a pixel's width beforehand (``width_prior.py``) enters as one more
measurement. Samples are independent with the variance of ``noise.py`` at the model's own height; clipped samples are left out.
Where curves have flat tops and sharp corners, the place is the mean of its likelihood instead, and its sd the likelihood's.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int, Int64

from recon.sweeps.curve_lookup import table_arrays
from recon.sweeps.curve_samples import CurveSamples, SweepCurves
from recon.sweeps.curve_table import CurveTable
from recon.sweeps.noise import NoiseModel
from recon.sweeps.scan_templates import coarse_templates, fine_templates
from recon.sweeps.stripe_scan import best_places, place_spreads
from recon.sweeps.stripe_walk import light_of_pixels, walk_pixels

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
    # Curves of footprints thinner than the table's thinnest are all alike.
    thinnest, widest = curves.table.log_width[[0, -1]]
    prior = WidthPrior(prior.shape, np.clip(prior.log_width, thinnest, widest), prior.sd)
    result = np.empty((len(StripeFit.__slots__), len(pixels)))
    for low in range(0, len(pixels), PIXELS_A_BLOCK):
        rows = slice(low, low + PIXELS_A_BLOCK)
        result[:, rows] = _fit_block(curves.samples(pixels[rows]), prior.some(rows), table=curves.table, noise=noise).T
    return StripeFit(*result)


def _fit_block(
    samples: CurveSamples, prior: WidthPrior, *, table: CurveTable, noise: NoiseModel
) -> Float64[np.ndarray, "pixels 8"]:
    """Scan, walk, and where the curve is angular take the likelihood's own mean and spread."""
    black_weight = 1 / noise.read_variance
    height, peak = samples.height, samples.peak
    weight = weights_of(height, samples, noise)
    start_px = np.empty(len(peak))
    templates, row = coarse_templates(table, prior.log_width)
    best_places(height, weight, black_weight, peak, row, templates, start_px)
    # The samples' own counts gave the first weights; the curve's heights, free of their noise, give the last.
    arrays, light = table_arrays(table), np.empty_like(height)
    known = (prior.shape, prior.log_width, prior.sd)
    while not light_of_pixels(height, weight, black_weight, peak, start_px, *known[:2], arrays, light):
        table.fill(arrays.wanted)
    weight = weights_of(light, samples, noise)
    angular = np.flatnonzero(np.exp(prior.log_width) < angular_px(table))
    if len(angular):
        fine, rows = fine_templates(table, *(one[angular] for one in known))
        spread = np.empty((3, len(angular)))
        place_spreads(
            height[angular], weight[angular], black_weight, peak[angular], rows, fine, start_px[angular], spread
        )
        # On a flat top the walk has nothing to go by: it begins where the finer grid is best.
        start_px[angular] = spread[2]
    fit, done = np.empty((len(peak), len(StripeFit.__slots__))), np.zeros(len(peak), dtype=bool)
    while walk_pixels(height, weight, black_weight, peak, start_px, *known, arrays, fit, done):
        table.fill(arrays.wanted)
    if len(angular):
        fit[angular, :2] = _settled(*fit[angular, :2].T, *spread[:2], fine.spacing_px)
    fit[:, 0] += samples.peak_px
    return fit


def _settled(
    place_px: np.ndarray, sd_px: np.ndarray, mean_px: np.ndarray, spread_px: np.ndarray, spacing_px: float
) -> Float64[np.ndarray, "pixels 2"]:
    """Return place and sd of angular curves from those of the walk and of the likelihood over a grid."""
    larger_px = np.maximum(sd_px, spread_px)
    # The grid is too coarse for the sharpest likelihoods, and the curvature right where it is that sharp.
    curved = larger_px < spacing_px
    least_px = spacing_px / np.sqrt(12)
    return np.stack(
        [np.where(curved, place_px, mean_px), np.where(curved, larger_px, np.maximum(spread_px, least_px))], axis=1
    )


def weights_of(height: np.ndarray, samples: CurveSamples, noise: NoiseModel) -> np.ndarray:
    """Return one over the variance that samples of these heights have; zero for those that may not be used."""
    weight: np.ndarray = np.reciprocal(noise.variance(height), dtype=np.float32)
    weight *= samples.usable
    return weight


def angular_px(table: CurveTable) -> float:
    """Return the width of a footprint below which curves have flat tops and sharp corners."""
    if not table.continuous:
        return ANGULAR_STEPPED_PX
    return ANGULAR_HARD_PX * table.pattern.step_px if table.pattern.profile == "hard" else 0.0
