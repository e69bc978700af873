"""The intensity curve of one pixel: the stripe's profile averaged over the pixel's footprint on the display.

Where the map from camera to display is locally affine, a square pixel's footprint along one display axis is a
box of width |du/dcol| convolved with a box of width |du/drow|. The average of a profile p over it is the second
difference of p's second antiderivative P2::

    m(x) = [P2(x+a+b) − P2(x+a−b) − P2(x−a+b) + P2(x−a−b)] / (4ab),    a, b half widths

which is exact for the hard stripe and for the raised cosine. A real display shows the profile in steps, one level a device
pixel; a footprint inside one device pixel sees the same curve wherever it lies in it. Then the footprint's share of
each device pixel is m of a unit box, and the curve is the shares times the levels (``curve_table.py``).
"""

import numpy as np
from jaxtyping import Float64

from recon.sessions.manifest import StripePattern

# A footprint thinner than this (display pixels) is a point as far as any photo can tell.
THINNEST_FOOTPRINT_PX = 1e-2
# A curve whose misfit is a quarter of its height is not that of one stripe.
LARGEST_MISFIT = 0.25

UNIT_BOX = StripePattern(profile="hard", width_px=1.0, first_px=0.0, step_px=1.0, count=3)

Curves = Float64[np.ndarray, "pixels samples"]
PerPixel = Float64[np.ndarray, " pixels"]


def profile_integrals(x: np.ndarray, pattern: StripePattern) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and second antiderivative of the stripe's profile, both zero at the stripe's centre.

    Beyond the profile's edge the first is constant, so the second grows linearly.
    """
    half = pattern.width_px / 2
    inside = np.clip(x, -half, half)
    beyond = np.abs(x) - np.abs(inside)
    if pattern.profile == "hard":
        return inside, 0.5 * inside**2 + half * beyond
    wave = 2 * np.pi / pattern.width_px
    angle = wave * inside
    first = 0.5 * (inside + np.sin(angle) / wave)
    second = 0.25 * inside**2 + (0.5 / wave**2) * (1 - np.cos(angle)) + 0.5 * half * beyond
    return first, second


def footprint_average(
    x: Curves, width_a_px: PerPixel, width_b_px: PerPixel, pattern: StripePattern
) -> tuple[Curves, Curves]:
    """Return the averaged profile at distance ``x`` from the stripe's centre, and its derivative by ``x``."""
    a = np.maximum(width_a_px, THINNEST_FOOTPRINT_PX)[:, None] / 2
    b = np.maximum(width_b_px, THINNEST_FOOTPRINT_PX)[:, None] / 2
    value = np.zeros_like(x)
    slope = np.zeros_like(x)
    for shift, sign in ((a + b, 1), (a - b, -1), (b - a, -1), (-a - b, 1)):
        first, second = profile_integrals(x + shift, pattern)
        value += sign * second
        slope += sign * first
    scale = 1 / (4 * a * b)
    return value * scale, slope * scale
