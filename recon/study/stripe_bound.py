"""The Cramér–Rao bound of a stripe's place, from the profile that is sampled and nothing of the decoder's.

The profile is averaged over a Gaussian footprint by quadrature, and differentiated numerically. Samples are Gaussian with a
variance that may follow their height, so that Fisher's information is ``Σ J Jᵀ / v + ½ Σ (∂v)(∂v)ᵀ / v²`` (Kay 1993, eq. 3.31).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float64

from recon.patterns.sweep_frames import stripe_profile
from recon.sessions.pattern import StripePattern

QUADRATURE_POINTS = 200
PHASES = 40
DIFFERENCE = 1e-3


@dataclass(frozen=True, slots=True)
class SampleNoise:
    """Variance ``read + gain · height`` of a sample, in units of the peak's height."""

    read: float
    gain: float = 0.0

    def variance(self, height: Float64[np.ndarray, "..."]) -> Float64[np.ndarray, "..."]:
        """Return the variance of samples of these heights."""
        return self.read + self.gain * height


def blurred_profile(
    offset_px: Float64[np.ndarray, " samples"], footprint_sd_px: float, pattern: StripePattern
) -> Float64[np.ndarray, " samples"]:
    """Return the stripe's brightness averaged over a Gaussian footprint whose centre is ``offset_px`` from the stripe's."""
    half = pattern.width_px / 2
    node, weight = _quadrature()
    place = half * node
    level = half * weight * stripe_profile(place * (1 - 1e-12), pattern)
    distance = (np.asarray(offset_px)[:, None] - place) / footprint_sd_px
    return np.exp(-0.5 * distance**2) @ level / (footprint_sd_px * np.sqrt(2 * np.pi))


@cache
def _quadrature() -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss and Legendre's nodes and weights."""
    node, weight = np.polynomial.legendre.leggauss(QUADRATURE_POINTS)
    return node, weight


def place_bound_px(footprint_sd_px: float, pattern: StripePattern, *, noise: SampleNoise, width_known: bool) -> float:
    """Return the least rms that an unbiased estimate of the place can have, in device pixels.

    Unknown are place, amplitude and background, which a black photo measures once more, and the footprint's width unless
    ``width_known``. All samples of the sweep count; variances are averaged over the place within a step.
    """
    reach = int(np.ceil((pattern.width_px / 2 + 6 * footprint_sd_px) / pattern.step_px)) + 1
    stripe = pattern.step_px * np.arange(-reach, reach + 1)
    peak = float(blurred_profile(np.zeros(1), footprint_sd_px, pattern)[0])

    def heights(unknown: np.ndarray) -> np.ndarray:
        place, amplitude, background, log_width = unknown
        return background + amplitude * blurred_profile(place - stripe, float(np.exp(log_width)), pattern) / peak

    count = 3 if width_known else 4
    variances = []
    for phase in (np.arange(PHASES) + 0.5) / PHASES - 0.5:
        centre = np.array([phase * pattern.step_px, 1.0, 0.0, np.log(footprint_sd_px)])
        height = heights(centre)
        jacobian = _jacobian(heights, centre)[:, :count]
        variance = noise.variance(height)
        information = (jacobian.T / variance) @ jacobian
        by_unknown = noise.gain * jacobian / variance[:, None]
        information += 0.5 * by_unknown.T @ by_unknown
        information[2, 2] += 1 / noise.read
        variances.append(np.linalg.inv(information)[0, 0])
    return float(np.sqrt(np.mean(variances)))


def _jacobian(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> np.ndarray:
    """Return the derivatives of a vector by central differences."""
    columns = []
    for number in range(len(at)):
        shift = np.zeros(len(at))
        shift[number] = DIFFERENCE
        columns.append((function(at + shift) - function(at - shift)) / (2 * DIFFERENCE))
    return np.stack(columns, axis=1)
