"""Where the centre of a pixel looks whose footprint on the display is bent, or not evenly lit.

Where the map from camera to display bends, or the light fades, more of a pixel's light comes from one side of its footprint, and
a fit with a symmetric footprint finds a place beside the one that its centre sees. Neighbours have the same error: a surface
follows it, and no gap shows it. But map and light are known from the pixels about each.

A curve tells a place by how much of the footprint lies below each edge between two device pixels within it. With the place
u + g·x + ½ x·C x and the light 1 + a·x over the pixel, x from −½ to ½ each way, an edge at e parts it along g·x = e − u. There
the bend moves light across the edge, ∫ ½ x·C x along that line over |g|, and below it lies ∫ a·x more. Either over the line's
length is how far the place seems to be off, to first order. Of several edges each counts as the fit counts it: by what its
light does to the samples, and by their noise. A footprint within one device pixel holds no edge and says no more than before.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int

from recon.compiled import compiled
from recon.patterns.sweep_frames import device_brightness
from recon.sessions.manifest import StripePattern
from recon.sweeps.edge_shifts import SPREAD_PX, told_to_others
from recon.sweeps.map_bends import map_bends
from recon.sweeps.noise import NoiseModel

# Quadratic surfaces through so many pixels each way tell how the map bends: the larger window where it holds, else the smaller.
WINDOWS_PX = (9, 5)
# A footprint is cut into so many lines; one with more edges than these is left as it is.
LINES = 8
MOST_EDGES = 256
BAND_ROWS = 128
# So many pixels at a time keep all lanes of a core busy.
LANES = 32

Grid = Float[np.ndarray, "rows cols"]
SmallGrid = Float32[np.ndarray, "rows cols"]
Mask = Bool[np.ndarray, "rows cols"]


def centre_shifts(
    place_px: Grid,
    sd_px: Grid,
    trusted: Mask,
    pixels: Int[np.ndarray, " pixels"],
    light: Float32[np.ndarray, " pixels"],
    *,
    pattern: StripePattern,
    noise: NoiseModel,
) -> tuple[SmallGrid, SmallGrid]:
    """Return by how much places lie beside those of the pixels' centres, in device pixels, and how unsure that is.

    Beside an edge of the map no window holds; what the pixels next to it are off by is taken there. It is no surer than itself,
    nor than what fading light and a bend move a place by there, which may be far more than farther in, where the one often
    makes up for the other: the second map holds the standard deviation by both, 0 elsewhere.

    Parameters
    ----------
    place_px, sd_px
        Maps in device pixels, NaN where there is no place.
    trusted
        Pixels that saw one stripe, by one path: they alone tell, and are told.
    pixels, light
        The pixels that were fitted (row · columns + column), in ascending order, and the height of each one's curve in counts.
    noise
        The noise by which the samples were weighed.
    """
    rows, cols = place_px.shape
    shift, doubt = np.zeros((2, *place_px.shape), np.float32)
    margin, stripe = 2 * (max(WINDOWS_PX) // 2) + SPREAD_PX, Stripe.of(pattern, noise)
    for top in range(0, rows, BAND_ROWS):
        bottom = min(top + BAND_ROWS, rows)
        above, below = max(top - margin, 0), min(bottom + margin, rows)
        listed = slice(*np.searchsorted(pixels, np.array([above * cols, below * cols], dtype=pixels.dtype)))
        lit = np.zeros((below - above, cols), np.float32)
        lit.ravel()[pixels[listed] - above * cols] = light[listed]
        there = trusted[above:below] & np.isfinite(place_px[above:below]) & (lit > 0)
        columns = np.flatnonzero(there.any(axis=0))
        if not len(columns):
            continue
        part = slice(above, below), slice(columns[0], columns[-1] + 1)
        lit, there = lit[:, part[1]], np.ascontiguousarray(there[:, part[1]])
        place, sd = (np.where(there, one[part], 0).astype(np.float32) for one in (place_px, sd_px))
        fading = np.log(np.where(there, lit, np.float32(1)))
        found, known = _shifts(place, sd, fading, there, stripe)
        inner, own = slice(top - above, bottom - above), (slice(top, bottom), part[1])
        unsure = told_to_others(found, known, place, fading, there)
        shift[own], doubt[own] = found[inner], unsure[inner]
    return shift, doubt


class Stripe(NamedTuple):
    """What a stripe lights and how its samples are weighed.

    ``brightness`` is that of device pixels about the stripe's own, the middle one; it stands on every ``step``-th of them, of
    which ``first`` is one. ``variance`` holds the terms of :class:`~recon.sweeps.noise.NoiseModel`.
    """

    brightness: Float64[np.ndarray, " places"]
    step: int
    first: int
    variance: tuple[float, float, float]

    @classmethod
    def of(cls, pattern: StripePattern, noise: NoiseModel) -> "Stripe":
        """Lay out a pattern's stripe; where it moves by less than a device pixel, as if it moved by one."""
        widest = int(np.ceil(pattern.width_px)) + 2
        brightness = device_brightness(np.arange(-widest, widest + 1.0), pattern)
        lit = np.flatnonzero(brightness)
        dark = int(min(lit[0], len(brightness) - 1 - lit[-1])) - 1  # one dark place is kept at either end
        return cls(
            brightness[dark : len(brightness) - dark],
            max(1, round(pattern.step_px)),
            round(pattern.first_px),
            (noise.read_variance, noise.gain, noise.relative),
        )


def _shifts(
    place: SmallGrid, sd_px: SmallGrid, fading: SmallGrid, there: Mask, stripe: Stripe
) -> tuple[SmallGrid, Mask]:
    """Return the shifts of the pixels whose surface is known, and which these are; ``fading`` is the logarithm of the light."""
    light = np.exp(fading)
    shift, known = np.zeros(there.shape, np.float32), np.zeros(there.shape, dtype=bool)
    for window_px in WINDOWS_PX:
        terms, holds = map_bends(place, sd_px, fading, there, window_px=window_px)
        holds &= ~known
        numbers = np.flatnonzero(holds)
        flat = terms.reshape(len(terms), -1)
        _write_shifts(place.ravel(), light.ravel(), flat, numbers, *stripe, shift.ravel())
        known |= holds
    return shift, known


@compiled
def _write_shifts(
    place: np.ndarray,
    light: np.ndarray,
    terms: np.ndarray,
    pixels: np.ndarray,
    brightness: np.ndarray,
    step: int,
    first_stripe: int,
    variance: tuple[float, float, float],
    shift: np.ndarray,
) -> None:
    """Write the shifts of some pixels by the terms of the map about them."""
    counts, firsts, offset = np.empty(LANES, np.int64), np.empty(LANES, np.int64), np.empty(LANES, np.float32)
    steepness, other = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    bend, bend_across, twist = np.empty(LANES, np.float32), np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    fading, fading_across = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    cut, bent, under = np.empty(LANES, np.float32), np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    length, moved = np.empty((LANES, MOST_EDGES), np.float32), np.empty((LANES, MOST_EDGES), np.float32)
    below = np.empty((LANES, MOST_EDGES), np.float32)
    half = np.float32(0.5)
    for low in range(0, len(pixels), LANES):
        longest = 0
        for lane in range(LANES):
            pixel = pixels[min(low + lane, len(pixels) - 1)]
            # The pixel is turned so that its place grows along x and y, x the steeper one.
            steep = 0 if abs(terms[0, pixel]) >= abs(terms[1, pixel]) else 1
            slope, slope_across = terms[steep, pixel], terms[1 - steep, pixel]
            along, across = np.sign(slope), np.sign(slope_across)
            reach = 0.5 * (np.float64(abs(slope)) + np.float64(abs(slope_across)))
            first = np.ceil(place[pixel] - reach - 0.5)
            edges = int(np.floor(place[pixel] + reach - 0.5) - first) + 1
            counts[lane] = edges if slope != 0 and 0 < edges <= MOST_EDGES else 0
            longest = max(longest, counts[lane])
            steepness[lane], other[lane] = 1 / abs(slope), abs(slope_across)
            bend[lane], bend_across[lane] = terms[2 + 2 * steep, pixel], terms[4 - 2 * steep, pixel]
            twist[lane] = along * across * terms[3, pixel]
            fading[lane], fading_across[lane] = along * terms[5 + steep, pixel], across * terms[6 - steep, pixel]
            offset[lane], firsts[lane] = first + 0.5 - place[pixel], np.int64(first)
        for edge in range(longest):
            cut[:], bent[:], under[:] = np.float32(0), np.float32(0), np.float32(0)
            for line in range(LINES):
                y, number = np.float32((line + 0.5) / LINES - 0.5), np.float32(edge)
                for lane in range(LANES):
                    x = (offset[lane] + number - other[lane] * y) * steepness[lane]
                    crossed = steepness[lane] if abs(x) < half else np.float32(0)
                    rise = half * (bend[lane] * x * x + bend_across[lane] * y * y) + twist[lane] * x * y
                    cut[lane] += crossed
                    x = half if x > half else x
                    x = -half if x < -half else x
                    faded = half * fading[lane] * (x * x - np.float32(0.25)) + fading_across[lane] * y * (x + half)
                    bent[lane] += rise * crossed - faded
                    under[lane] += x + half
            length[:, edge], moved[:, edge], below[:, edge] = cut, bent, under
        for lane in range(min(LANES, len(pixels) - low)):
            edges, pixel = counts[lane], pixels[low + lane]
            if edges == 1:
                shift[pixel] = moved[lane, 0] / length[lane, 0] if length[lane, 0] > 0 else np.float32(0)
            elif edges > 1:
                before = (first_stripe - firsts[lane]) % step
                shift[pixel] = _weighed(
                    length[lane, :edges],
                    moved[lane, :edges],
                    below[lane, :edges],
                    before,
                    step,
                    brightness,
                    light[pixel],
                    variance,
                )


@compiled
def _weighed(
    length: np.ndarray,
    moved: np.ndarray,
    below: np.ndarray,
    before: int,
    step: int,
    brightness: np.ndarray,
    light: float,
    variance: tuple[float, float, float],
) -> float:
    """Return the shift that several edges tell together, each sample weighed by its noise; edge 0 ends device pixel 0.

    The sample with the stripe on device pixel p is that of the last device pixel less, at every edge, what lies below it
    (``below``, of ``LINES``) times the step of brightness there.
    """
    edges, reach = len(length), len(brightness) // 2
    read, gain, relative = variance
    total = weight = 0.0
    stripe = before - step * ((reach + before) // step)
    while stripe <= edges + reach:
        last = edges - stripe + reach
        seen = brightness[last] if 0 <= last < len(brightness) else 0.0
        steeper = off = 0.0
        for edge in range(max(stripe - reach, 0), min(stripe + reach, edges)):
            place = edge - stripe + reach
            change = brightness[place + 1] - brightness[place]
            steeper += length[edge] * change
            off += moved[edge] * change
            seen -= below[edge] / LINES * change
        height = max(seen, 0.0) * light
        precision = 1 / (read + gain * height + (relative * height) ** 2)
        total += precision * steeper * off
        weight += precision * steeper * steeper
        stripe += step
    return total / weight if weight > 0 else 0.0
