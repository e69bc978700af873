"""Which share of its samples' noise a fit follows: a residual has the rest of it."""

import numpy as np

from recon.compiled import compiled
from recon.sweeps.curve_lookup import looked_up
from recon.sweeps.curve_samples import CurveSamples
from recon.sweeps.curve_table import CurveTable
from recon.sweeps.noise import NoiseModel
from recon.sweeps.stripe_fit import StripeFit, WidthPrior, weights_of

RIDGE = 1e-9  # of the information on all parameters


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
    leverage = np.empty_like(curve)
    derivatives = (curve, amplitude * by_place, amplitude * by_width)
    write_leverage(*derivatives, weight, 1 / noise.read_variance, 1 / prior.sd**2, leverage)
    return lit, residual, leverage


@compiled
def write_leverage(
    curve: np.ndarray,
    by_place: np.ndarray,
    by_width: np.ndarray,
    weight: np.ndarray,
    black_weight: float,
    width_weight: np.ndarray,
    leverage: np.ndarray,
) -> None:
    """Write the leverage of every sample [pixels, samples] from the derivatives by amplitude, place and width.

    That by the background is one; ``black_weight`` and ``width_weight`` [pixels] are what was known of it and of the width.
    """
    normal, design = np.empty((4, 4)), np.ones(4)
    for pixel in range(len(curve)):
        normal[:] = 0.0
        for s in range(curve.shape[1]):
            design[0], design[2], design[3] = curve[pixel, s], by_place[pixel, s], by_width[pixel, s]
            for row in range(4):
                for column in range(row + 1):
                    normal[row, column] += weight[pixel, s] * design[row] * design[column]
        normal[1, 1] += black_weight
        normal[3, 3] += width_weight[pixel]
        # A parameter that the curve does not hold follows nothing.
        ridge = RIDGE * (normal[0, 0] + normal[1, 1] + normal[2, 2] + normal[3, 3])
        # Cholesky's lower triangle, in place.
        for column in range(4):
            normal[column, column] += ridge
            for k in range(column):
                normal[column, column] -= normal[column, k] * normal[column, k]
            normal[column, column] = np.sqrt(max(normal[column, column], RIDGE * ridge))
            for row in range(column + 1, 4):
                for k in range(column):
                    normal[row, column] -= normal[row, k] * normal[column, k]
                normal[row, column] /= normal[column, column]
        for s in range(curve.shape[1]):
            design[0], design[2], design[3] = curve[pixel, s], by_place[pixel, s], by_width[pixel, s]
            square = 0.0
            for row in range(4):
                for k in range(row):
                    design[row] -= normal[row, k] * design[k]
                design[row] /= normal[row, row]
                square += design[row] * design[row]
            leverage[pixel, s] = weight[pixel, s] * square
            design[1] = 1.0
