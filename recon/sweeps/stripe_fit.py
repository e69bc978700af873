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
from recon.sweeps.curve_samples import CurveSamples, SweepCurves, write_weights
from recon.sweeps.curve_table import CurveTable
from recon.sweeps.noise import NoiseModel
from recon.sweeps.scan_templates import coarse_templates, fine_templates
from recon.sweeps.stripe_scan import best_places, place_spreads
from recon.sweeps.stripe_walk import Pixels, step_pixels, weigh_pixels

GAUSS_NEWTON_STEPS = 6
# Curves of narrower footprints have flat tops and sharp corners, on which curvature says nothing: a box as wide as the step of a
# hard stripe has a standard deviation of 1 / √12 steps.
ANGULAR_HARD_STEPS = 0.3
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
        result[:, rows] = _fit_block(curves.samples(pixels[rows]), prior.some(rows), table=curves.table, noise=noise)
    return StripeFit(*result)


def _fit_block(
    samples: CurveSamples, prior: WidthPrior, *, table: CurveTable, noise: NoiseModel
) -> Float64[np.ndarray, "8 pixels"]:
    """Scan, walk, and where the curve is angular take the likelihood's own mean and spread."""
    known = (prior.shape, prior.log_width, prior.sd)
    weight, place_px = weights_of(samples.height, samples, noise), np.empty(len(samples.peak))
    row, templates = table.nearest_node(prior.log_width), coarse_templates(table)
    best_places(samples.height, weight, 1 / noise.read_variance, samples.peak, row, templates, place_px)
    # The samples' own counts gave the first weights; the curve's heights, free of their noise, give the last.
    pixels = Pixels(samples.height, weight, samples.peak, *known, noise.read_variance, noise.gain, noise.relative)
    flat = prior.log_width < angular_log_width(table)
    angular = np.flatnonzero(flat)
    fit = np.empty((len(StripeFit.__slots__), len(flat)))
    _walk(fit, np.flatnonzero(~flat), place_px, pixels, table=table, weigh=True)
    if len(angular):
        table.fill_about(prior.shape, prior.log_width, angular)
        weigh_pixels(angular, pixels, place_px, table_arrays(table))
        spread, spacing_px = _spread(angular, place_px, pixels, table=table)
        # On a flat top the walk has nothing to go by: it begins where the finer grid is best.
        place_px[angular] = spread[2]
        _walk(fit, angular, place_px, pixels, table=table, weigh=False)
        fit[:2, angular] = _settled(fit[:2, angular], spread, spacing_px=spacing_px)
    fit[0] += samples.peak_px
    return fit


def _walk(
    fit: Float64[np.ndarray, "8 pixels"],
    moving: Int64[np.ndarray, " moving"],
    start_px: Float64[np.ndarray, " pixels"],
    pixels: Pixels,
    *,
    table: CurveTable,
    weigh: bool,
) -> None:
    """Let some of the pixels walk from their start until they have settled, and write their columns of ``fit``."""
    moving, place_px, log_width = moving.copy(), start_px.copy(), pixels.log_width.copy()
    objective = np.full(len(start_px), np.inf)
    for step in range(GAUSS_NEWTON_STEPS):
        if not len(moving):
            break
        table.fill_about(pixels.shape, log_width, moving)
        left = step_pixels(
            moving, pixels, table_arrays(table), place_px, log_width, objective, fit, weigh and step == 0
        )
        moving = moving[:left]


def _spread(
    angular: Int64[np.ndarray, " angular"],
    place_px: Float64[np.ndarray, " pixels"],
    pixels: Pixels,
    *,
    table: CurveTable,
) -> tuple[Float64[np.ndarray, "3 angular"], float]:
    """Return mean, sd and likeliest place (from the peak's on) of some of the pixels, and the spacing of the grid."""
    known = (one[angular] for one in (pixels.shape, pixels.log_width, pixels.width_sd))
    samples = (pixels.height[angular], pixels.weight[angular], 1 / pixels.read, pixels.peak[angular])
    templates, rows = fine_templates(table, *known)
    spread = np.empty((3, len(angular)))
    place_spreads(*samples, rows, templates, place_px[angular], spread)
    return spread, templates.spacing_px


def _settled(
    walked: Float64[np.ndarray, "2 pixels"], spread: Float64[np.ndarray, "3 pixels"], *, spacing_px: float
) -> Float64[np.ndarray, "2 pixels"]:
    """Return place and sd of angular curves from those of the walk and those of the likelihood over a grid."""
    place_px, sd_px = walked
    mean_px, spread_px, _ = spread
    larger_px = np.maximum(sd_px, spread_px)
    # The grid is too coarse for the sharpest likelihoods, and the curvature right where it is that sharp.
    curved = larger_px < spacing_px
    least_px = np.maximum(spread_px, spacing_px / np.sqrt(12))
    return np.stack([np.where(curved, place_px, mean_px), np.where(curved, larger_px, least_px)])


def weights_of(height: np.ndarray, samples: CurveSamples, noise: NoiseModel) -> np.ndarray:
    """Return one over the variance that samples of these heights have; zero for those that may not be used."""
    weight = np.empty(height.shape, dtype=np.float32)
    write_weights(height, samples.usable, noise.read_variance, noise.gain, noise.relative, weight)
    return weight


def angular_log_width(table: CurveTable) -> float:
    """Return the logarithm of the width in px of a footprint below which curves have flat tops and sharp corners."""
    hard_px = ANGULAR_HARD_STEPS * table.pattern.step_px if table.pattern.profile == "hard" else 0.0
    angular_px = hard_px if table.continuous else max(hard_px, ANGULAR_STEPPED_PX)
    return float(np.log(angular_px)) if angular_px > 0 else -np.inf
