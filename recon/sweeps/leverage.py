"""Which share of its samples' noise a fit follows: a residual has the rest of it."""

from itertools import combinations_with_replacement

import numpy as np

from recon.sweeps.curve_lookup import looked_up
from recon.sweeps.curve_samples import CurveSamples
from recon.sweeps.curve_table import CurveTable
from recon.sweeps.noise import NoiseModel
from recon.sweeps.stripe_fit import StripeFit, WidthPrior, weights_of


def leverage_of(
    samples: CurveSamples, fit: StripeFit, prior: WidthPrior, *, table: CurveTable, noise: NoiseModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the fitted height, the residual and the leverage of every sample [pixels, samples].

    The leverage is the share of a sample's noise that the fit follows: a residual has (1 − leverage) times its variance.
    """
    curve, by_place, by_width = looked_up(samples, fit.place_px, fit.log_width, shape=prior.shape, table=table)
    amplitude = fit.amplitude[:, None]
    lit = amplitude * curve
    residual = samples.height - lit - fit.background[:, None]
    weight = weights_of(lit, samples, noise)
    design = (curve, np.ones_like(curve), amplitude * by_place, amplitude * by_width)
    weighted = tuple(weight * part for part in design)
    normal = np.empty((len(curve), len(design), len(design)))
    for row, column in combinations_with_replacement(range(len(design)), 2):
        normal[:, row, column] = normal[:, column, row] = np.einsum("ps,ps->p", weighted[row], design[column])
    normal[:, 1, 1] += 1 / noise.read_variance
    normal[:, 3, 3] += 1 / prior.sd**2
    # A parameter that the curve does not hold follows nothing.
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    inverse = np.linalg.inv(normal)
    leverage = np.zeros_like(curve)
    for row, part in enumerate(weighted):
        leverage += part * sum(inverse[:, row, column, None] * other for column, other in enumerate(design))
    return lit, residual, leverage
