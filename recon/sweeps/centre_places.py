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

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int

from recon.compiled import compiled
from recon.patterns.sweep_frames import device_brightness
from recon.sessions.manifest import StripePattern

# Quadratic surfaces through so many pixels each way tell how the map bends: the larger window where it holds, else the smaller.
WINDOWS_PX = (9, 5)
# A window holds where its places scatter no more than so many of their sds about its surface, and the light no more than so
# much of itself. Compressed photos leave errors that no pixel's sd tells.
LARGEST_ROUGHNESS = 2.0
SUREST_PX = 0.01
LARGEST_FLICKER = 0.1
# From a pixel with such a window its shift is told to others so far away.
SPREAD_PX = 6
# A footprint is cut into so many lines, and no more than so many edges within it are looked at.
LINES = 8
MOST_EDGES = 48
BAND_ROWS = 128

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
        part, inner = slice(above, below), slice(top - above, bottom - above)
        listed = slice(*np.searchsorted(pixels, np.array([above * cols, below * cols], dtype=pixels.dtype)))
        lit = np.zeros((below - above, cols), np.float32)
        lit.ravel()[pixels[listed] - above * cols] = light[listed]
        there = trusted[part] & np.isfinite(place_px[part]) & (lit > 0)
        if not there.any():
            continue
        place, sd = np.where(there, place_px[part], 0.0), np.where(there, sd_px[part], 0.0)
        terms, known = _surfaces(place.astype(np.float32), sd.astype(np.float32), lit, there)
        found = np.zeros(there.shape, np.float32)
        _write_shifts(place.astype(np.float64), terms, known, alike, found)
        by_others[top:bottom] = _told_to_others(found, known, there)[inner]
        shift[top:bottom] = found[inner]
    return shift, by_others


def _alike(pattern: StripePattern) -> Float64[np.ndarray, " apart"]:
    """Return how alike the light changes at two edges of device pixels while the stripe passes, by how far they are apart."""
    reach = int(np.ceil(pattern.width_px)) + 2
    change = np.diff(device_brightness(np.arange(-reach, reach + 1.0), pattern))
    return np.correlate(np.pad(change, (0, MOST_EDGES)), change, "valid")[:MOST_EDGES].copy()


def _surfaces(
    value: SmallGrid, sd_px: SmallGrid, lit: SmallGrid, there: Mask
) -> tuple[Float32[np.ndarray, "7 rows cols"], Mask]:
    """Return slopes by column and row, bends by column, both and row, the light's fading each way, and where they are known."""
    certainty = 1 / (sd_px**2 + np.float32(SUREST_PX**2))
    fading = np.log(np.where(there, lit, np.float32(1)))
    terms, known = np.zeros((7, *there.shape), np.float32), np.zeros(there.shape, dtype=bool)
    for window_px in WINDOWS_PX:
        found, holds = _through_windows(value, certainty, fading, there, window_px)
        np.copyto(terms, found, where=holds & ~known)
        known |= holds
    return terms, known


def _through_windows(
    value: SmallGrid, certainty: SmallGrid, fading: SmallGrid, there: Mask, window_px: int
) -> tuple[Float32[np.ndarray, "7 rows cols"], Mask]:
    """Return the terms of the surface through every window, and where that is whole and holds.

    Over a window 1, x, y, x² − m, x y and y² − m, with m the mean of x², are at right angles to each other.
    """
    even = np.ones(window_px, np.float32)
    along = np.arange(window_px, dtype=np.float32) - window_px // 2
    mean_square = float((along**2).mean())
    bent = (along**2 - mean_square).astype(np.float32)
    pixels, squares, bends = window_px**2, window_px * float((along**2).sum()), window_px * float((bent**2).sum())

    def sums(values: np.ndarray, by_col: np.ndarray, by_row: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(values, cv2.CV_32F, by_col, by_row, borderType=cv2.BORDER_CONSTANT)

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.blur(values, (window_px, window_px), borderType=cv2.BORDER_CONSTANT)

    terms = np.empty((7, *there.shape), np.float32)
    for number, (values, by_col, by_row, scale) in enumerate(
        (
            (value, along, even, 1 / squares),
            (value, even, along, 1 / squares),
            (value, bent, even, 2 / bends),
            (value, along, along, pixels / squares**2),
            (value, even, bent, 2 / bends),
            (fading, along, even, 1 / squares),
            (fading, even, along, 1 / squares),
        )
    ):
        np.multiply(sums(values, by_col, by_row), np.float32(scale), out=terms[number])
    whole = cv2.erode(there.astype(np.uint8), np.ones((window_px, window_px), np.uint8), borderValue=0).astype(bool)
    own = mean(value) - np.float32(0.5 * mean_square) * (terms[2] + terms[4])
    # What a place keeps of its own error beside the surface through its window.
    kept = 1 - 1 / pixels - 2 * mean_square**2 / bends
    rough = (value - own) ** 2 * certainty - np.float32(kept * LARGEST_ROUGHNESS**2)
    flicker = (fading - mean(fading)) ** 2 - np.float32(LARGEST_FLICKER**2)
    for one in (rough, flicker):
        one[~whole] = 0.0
        whole &= mean(one) <= 0
    return terms, whole


def _told_to_others(shift: SmallGrid, known: Mask, there: Mask) -> Mask:
    """Fill in the mean of the shifts beside pixels without one, from pixel to pixel; return which were filled in."""
    told = known.copy()
    for _ in range(SPREAD_PX):
        near = cv2.dilate(told.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0).astype(bool) & there & ~told
        if not near.any():
            break
        count, total = (
            cv2.boxFilter(one, cv2.CV_32F, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
            for one in (told.astype(np.float32), shift)
        )
        shift[near] = total[near] / np.maximum(count[near], 1.0)
        told |= near
    return told & ~known


@compiled
def _write_shifts(
    place: np.ndarray, terms: np.ndarray, known: np.ndarray, alike: np.ndarray, shift: np.ndarray
) -> None:
    """Write the shifts of the pixels whose surface is known."""
    rows, cols = known.shape
    most = len(alike)
    length, moved = np.empty(most), np.empty(most)
    for pixel in range(rows * cols):
        row, col = pixel // cols, pixel % cols
        if not known[row, col]:
            continue
        # The pixel is turned so that its place grows along x and y, x the steeper one.
        by_col, by_row = terms[0, row, col], terms[1, row, col]
        steep = 0 if abs(by_col) >= abs(by_row) else 1
        steeper, other = abs(terms[steep, row, col]), abs(terms[1 - steep, row, col])
        first = np.ceil(place[row, col] - 0.5 * (steeper + other) - 0.5)
        edges = int(np.floor(place[row, col] + 0.5 * (steeper + other) - 0.5) - first) + 1
        if edges < 1 or steeper == 0:
            continue
        edges = min(edges, most)
        along, across = np.sign(terms[steep, row, col]), np.sign(terms[1 - steep, row, col])
        bend, bend_across = terms[2 + 2 * steep, row, col], terms[4 - 2 * steep, row, col]
        twist = along * across * terms[3, row, col]
        fading, fading_across = along * terms[5 + steep, row, col], across * terms[6 - steep, row, col]
        for edge in range(edges):
            length[edge] = moved[edge] = 0.0
            for line in range(LINES):
                y = (line + 0.5) / LINES - 0.5
                x = (first + edge + 0.5 - place[row, col] - other * y) / steeper
                if abs(x) < 0.5:
                    length[edge] += 1 / steeper
                    moved[edge] += (0.5 * bend * x * x + twist * x * y + 0.5 * bend_across * y * y) / steeper
                x = min(max(x, -0.5), 0.5)
                moved[edge] -= 0.5 * fading * (x * x - 0.25) + fading_across * y * (x + 0.5)
        total = weight = 0.0
        for one in range(edges):
            for two in range(edges):
                total += alike[abs(one - two)] * length[one] * moved[two]
                weight += alike[abs(one - two)] * length[one] * length[two]
        if weight > 0:
            shift[row, col] = total / weight
