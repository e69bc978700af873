"""Where the centre of a pixel looks whose footprint on the display is bent, or not evenly lit.

Where the map from camera to display bends, or the light fades, more of a pixel's light comes from one side of its footprint, and
a fit with a symmetric footprint finds a place beside the one that its centre sees. Neighbours have the same error: a surface
follows it, and no gap shows it. But map and light are known from the pixels about each.

A curve tells a place by how much of the footprint lies below each edge between two device pixels within it. With the place
u + g·x + ½ x·C x and the light 1 + a·x over the pixel, x from −½ to ½ each way, an edge at e parts it along g·x = e − u. There
the bend moves light across the edge, ∫ ½ x·C x along that line over |g|, and below it lies ∫ a·x more. Either over the line's
length is how far the place seems to be off, to first order. Of several edges each counts as the fit counts it. A footprint
within one device pixel holds no edge and says no more than before.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int

from recon.compiled import compiled
from recon.patterns.sweep_frames import device_brightness
from recon.sessions.manifest import StripePattern
from recon.sweeps.map_bends import map_bends

# Quadratic surfaces through so many pixels each way tell how the map bends: the larger window where it holds, else the smaller.
WINDOWS_PX = (9, 5)
# From a pixel with such a window its shift is told to others so far away.
SPREAD_PX = 6
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
) -> tuple[SmallGrid, Mask]:
    """Return by how much places lie beside those of the pixels' centres, in device pixels, and where only neighbours tell so.

    Beside an edge of the map no window holds; what the pixels next to it are off by is taken there, and is no surer than itself.

    Parameters
    ----------
    place_px, sd_px
        Maps in device pixels, NaN where there is no place.
    trusted
        Pixels that saw one stripe, by one path: they alone tell, and are told.
    pixels, light
        The pixels that were fitted (row · columns + column), in ascending order, and the height of each one's curve in counts.
    """
    rows, cols = place_px.shape
    shift, by_others = np.zeros(place_px.shape, np.float32), np.zeros(place_px.shape, dtype=bool)
    margin, alike = 2 * (max(WINDOWS_PX) // 2) + SPREAD_PX, _alike(pattern)
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
        found, known = _shifts(place, sd, np.log(np.where(there, lit, np.float32(1))), there, alike)
        inner, own = slice(top - above, bottom - above), (slice(top, bottom), part[1])
        by_others[own] = _told_to_others(found, known, there)[inner]
        shift[own] = found[inner]
    return shift, by_others


def _alike(pattern: StripePattern) -> Float64[np.ndarray, " apart"]:
    """Return how alike the light changes at two edges of device pixels while the stripe passes, by how far they are apart."""
    reach = int(np.ceil(pattern.width_px)) + 2
    change = np.diff(device_brightness(np.arange(-reach, reach + 1.0), pattern))
    return np.correlate(change, change, "full")[len(change) - 1 :].copy()


def _shifts(
    place: SmallGrid, sd_px: SmallGrid, fading: SmallGrid, there: Mask, alike: Float64[np.ndarray, " apart"]
) -> tuple[SmallGrid, Mask]:
    """Return the shifts of the pixels whose surface is known, and which these are."""
    shift, known = np.zeros(there.shape, np.float32), np.zeros(there.shape, dtype=bool)
    for window_px in WINDOWS_PX:
        terms, holds = map_bends(place, sd_px, fading, there, window_px=window_px)
        holds &= ~known
        numbers = np.flatnonzero(holds)
        _write_shifts(place.ravel(), terms.reshape(len(terms), -1), numbers, alike, shift.ravel())
        known |= holds
    return shift, known


def _told_to_others(shift: SmallGrid, known: Mask, there: Mask) -> Mask:
    """Fill in the mean of the shifts beside pixels without one, from pixel to pixel; return which were filled in."""
    told = known.copy()
    others = np.flatnonzero(there & ~told)
    for _ in range(SPREAD_PX):
        means = np.full(len(others), np.nan, np.float32)
        _write_means_beside(shift, told, others, means)
        now = np.isfinite(means)
        if not now.any():
            break
        shift.ravel()[others[now]], told.ravel()[others[now]] = means[now], True
        others = others[~now]
    return told & ~known


@compiled
def _write_means_beside(shift: np.ndarray, told: np.ndarray, pixels: np.ndarray, means: np.ndarray) -> None:
    """Write the mean shift of the neighbours of some pixels that were told theirs, where there are any."""
    rows, cols = told.shape
    for number in range(len(pixels)):
        row, col = pixels[number] // cols, pixels[number] % cols
        count, total = 0, np.float32(0)
        for near_row in range(max(row - 1, 0), min(row + 2, rows)):
            for near_col in range(max(col - 1, 0), min(col + 2, cols)):
                if told[near_row, near_col]:
                    count += 1
                    total += shift[near_row, near_col]
        if count:
            means[number] = total / np.float32(count)


@compiled
def _write_shifts(
    place: np.ndarray, terms: np.ndarray, pixels: np.ndarray, alike: np.ndarray, shift: np.ndarray
) -> None:
    """Write the shifts of some pixels by the terms of the map about them."""
    apart = len(alike)
    counts, offset = np.empty(LANES, np.int64), np.empty(LANES, np.float32)
    steepness, other = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    bend, bend_across, twist = np.empty(LANES, np.float32), np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    fading, fading_across = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    cut, bent = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    length, moved = np.empty((MOST_EDGES, LANES), np.float32), np.empty((MOST_EDGES, LANES), np.float32)
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
            offset[lane] = first + 0.5 - place[pixel]
        for edge in range(longest):
            cut[:], bent[:] = np.float32(0), np.float32(0)
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
            length[edge, :], moved[edge, :] = cut, bent
        for lane in range(min(LANES, len(pixels) - low)):
            total = weight = 0.0
            for one in range(counts[lane]):
                for two in range(max(one + 1 - apart, 0), min(one + apart, counts[lane])):
                    total += alike[abs(one - two)] * length[one, lane] * moved[two, lane]
                    weight += alike[abs(one - two)] * length[one, lane] * length[two, lane]
            if weight > 0:
                shift[pixels[low + lane]] = total / weight
