"""The intensity curve of one pixel: the stripe's profile averaged over the pixel's footprint on the display.

Where the map from camera to display is locally affine, a square pixel's footprint along one display axis is a
box of width |du/dcol| convolved with a box of width |du/drow|. The average of a profile p over it is the second
difference of p's second antiderivative P2::

    m(x) = [P2(x+a+b) − P2(x+a−b) − P2(x−a+b) + P2(x−a−b)] / (4ab),    a, b half widths

which is exact for the hard stripe and for the raised cosine. A real display shows the profile in steps, one level a device
pixel; a footprint inside one device pixel sees the same curve wherever it lies in it. Then the footprint's share of
each device pixel is m of a unit box, and the curve is the shares times the levels.
"""

import numpy as np
from jaxtyping import Float64

from recon.patterns.sweep_frames import device_brightness
from recon.sessions.manifest import StripePattern

# A footprint thinner than this (display pixels) is a point as far as any photo can tell.
THINNEST_FOOTPRINT_PX = 1e-2
# Over a footprint this wide the steps of the device pixels average out (their effect falls with the square of the width).
WIDE_FOOTPRINT_PX = 5.0
# Beyond so many different alignments of stripe and device pixels each pixel's levels are computed on their own.
MOST_ALIGNMENTS = 64

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


def expected_curve(
    stripe_px: Curves,
    centre_px: PerPixel,
    footprint_px: Float64[np.ndarray, "pixels 2"],
    *,
    pattern: StripePattern,
    continuous: bool,
) -> tuple[Curves, Curves]:
    """Return each pixel's brightness (1 is a fully lit display) for stripes centred at ``stripe_px``, and its
    derivative by the footprint's centre ``centre_px``.

    ``continuous`` is for scenes whose stripe was drawn as a function and not on device pixels.
    """
    wide = np.full(len(centre_px), continuous) | (footprint_px.sum(axis=1) > WIDE_FOOTPRINT_PX)
    value, slope = np.empty_like(stripe_px), np.empty_like(stripe_px)
    if wide.any():
        offset = centre_px[wide, None] - stripe_px[wide]
        value[wide], slope[wide] = footprint_average(offset, footprint_px[wide, 0], footprint_px[wide, 1], pattern)
    if not wide.all():
        value[~wide], slope[~wide] = _stepped_curve(
            stripe_px[~wide], centre_px[~wide], footprint_px[~wide], pattern=pattern
        )
    return value, slope


def _stepped_curve(
    stripe_px: np.ndarray, centre_px: np.ndarray, footprint_px: np.ndarray, *, pattern: StripePattern
) -> tuple[np.ndarray, np.ndarray]:
    """Share each footprint out over device pixels, and weigh the levels that these show for each stripe."""
    base = np.rint(centre_px)
    reach = int(np.ceil(0.5 + footprint_px.sum(axis=1).max() / 2 + 0.5))
    device = np.arange(-reach, reach + 1.0)
    share, by_offset = footprint_average(
        (base - centre_px)[:, None] + device, footprint_px[:, 0], footprint_px[:, 1], UNIT_BOX
    )
    value, slope = np.empty_like(stripe_px), np.empty_like(stripe_px)
    # Pixels whose stripes stand alike on the device pixels share one table of levels.
    alignment = np.round(base - stripe_px[:, stripe_px.shape[1] // 2], 6)
    kinds, kind = np.unique(alignment, return_inverse=True)
    if len(kinds) > MOST_ALIGNMENTS:
        level = device_brightness(base[:, None, None] + device[:, None] - stripe_px[:, None, :], pattern)
        return np.einsum("pd,pds->ps", share, level), -np.einsum("pd,pds->ps", by_offset, level)
    for number in range(len(kinds)):
        rows = np.flatnonzero(kind == number)
        first = rows[0]
        level = device_brightness(base[first] + device[:, None] - stripe_px[first], pattern)
        value[rows] = share[rows] @ level
        slope[rows] = -(by_offset[rows] @ level)
    return value, slope
