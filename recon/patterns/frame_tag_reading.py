"""Reads a frame tag back from a photo, given about where it is; says why it cannot rather than give a wrong number.

The ring and the dark cells about it are the same in every tag. They fix where exactly the tag is, by the best correlation
over small shifts, turns and scales of the given place; then each pair of cells gives its bit.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Integer

from recon.patterns.frame_tag import (
    ACROSS_CELLS,
    DATA_CELLS,
    FIRST_DATA_CELL,
    bright_frame_cells,
    data_cells,
    number_of,
    tag_cells,
)

Fault = Literal["", "outside the photo", "too small", "too dark", "no tag here", "unclear cells", "check bits disagree"]

# Fewer photo pixels than this a cell, and neighbouring cells run into each other.
SMALLEST_CELL_PX = 2.0
# The given place may be wrong by one cell; the surroundings that are looked at reach half a cell further.
MARGIN_CELLS = 1.5
SMALLEST_CONTRAST = 6.0  # grey counts of 255: twice what JPEG and sensor leave in a dark corner
SMALLEST_CORRELATION = 0.75  # a sharp tag has 1, one blurred by half a cell 0.9, what is no tag at most about 0.5
GOOD_CORRELATION = 0.9
# A cell further than this share of its own light from what the number says it should be was covered, lit from elsewhere, or
# changed while the shutter was open: a photo that got a third of its light from another frame is no photo of either.
LARGEST_RESIDUAL = 0.3
LARGEST_SAMPLES_PER_CELL = 12

Photo = Integer[np.ndarray, "rows cols"] | Float32[np.ndarray, "rows cols"]
Corners = Float64[np.ndarray, "4 2"]


@dataclass(frozen=True, slots=True, eq=False)
class TagReading:
    """What was read. ``number`` is None where ``fault`` says why; ``corners_px`` is the place found, or the one given."""

    number: int | None
    fault: Fault
    corners_px: Corners
    contrast: float = 0.0
    correlation: float = 0.0

    def moved(self, x_px: int, y_px: int) -> "TagReading":
        """Return the reading of a part of a photo as one of the whole, given the part's first column and row."""
        return replace(self, corners_px=self.corners_px + np.array([x_px, y_px], dtype=np.float64))


@dataclass(frozen=True, slots=True)
class _Fit:
    """How the tag lies in the rectified picture: its centre's shift in cells, its turn, its scale, and how well it fits."""

    shift_x: float = 0.0
    shift_y: float = 0.0
    turn_rad: float = 0.0
    scale: float = 1.0
    correlation: float = -1.0


def read_tag(photo: Photo, corners_px: Corners, *, full_scale: float = 255.0) -> TagReading:
    """Read the tag whose corners are about at ``corners_px`` in a photo.

    Parameters
    ----------
    photo
        Grey counts.
    corners_px
        (x, y) in photo pixels of the tag's outer corners: top left, top right, bottom right, bottom left as the tag is
        drawn on the display. A cell too far to any side, 8 % too large or small, or 4° turned is near enough.
    full_scale
        The largest count that the photo can hold.

    Returns
    -------
    TagReading
        With ``number`` None unless every pair of cells is clear and the check bits agree.
    """
    sides_px = np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=0), axis=1)
    cell_px = float(sides_px.mean()) / ACROSS_CELLS
    unread = TagReading(None, "too small", corners_px)
    if not np.isfinite(corners_px).all() or not cell_px >= SMALLEST_CELL_PX:
        return unread
    rows, cols = photo.shape
    if corners_px.min() < -0.5 or (corners_px.max(axis=0) > np.array([cols, rows]) - 0.5).any():
        return replace(unread, fault="outside the photo")
    samples = int(np.clip(np.ceil(sides_px.max() / ACROSS_CELLS), 4, LARGEST_SAMPLES_PER_CELL))
    picture, photo_from_picture = _rectify(photo, corners_px, samples=samples)
    fit = _best_fit(picture, samples=samples)
    cells = _sample_cells(picture, [fit], samples=samples)[0] * (255.0 / full_scale)
    bright, fixed = bright_frame_cells(), ~data_cells()
    contrast = float(cells[bright].mean() - cells[fixed & ~bright].mean())
    found_px = _corners_of(fit, photo_from_picture, samples=samples)
    unread = TagReading(None, "too dark", corners_px, contrast, fit.correlation)
    if contrast < SMALLEST_CONTRAST:
        return unread
    if fit.correlation < SMALLEST_CORRELATION:
        return replace(unread, fault="no tag here")
    inside = cells[FIRST_DATA_CELL : FIRST_DATA_CELL + DATA_CELLS, FIRST_DATA_CELL : FIRST_DATA_CELL + DATA_CELLS]
    number = number_of((inside[:, 0::2] > inside[:, 1::2]).ravel())
    if number is None:
        return replace(unread, fault="check bits disagree", corners_px=found_px)
    if largest_residual(cells, number) > LARGEST_RESIDUAL:
        return replace(unread, fault="unclear cells", corners_px=found_px)
    return TagReading(number, "", found_px, contrast, fit.correlation)


def find_tag(photo: Photo, *, full_scale: float = 255.0) -> TagReading | None:
    """Look for a tag anywhere in a photo, or in a part cut out of one; None when there is none that can be read.

    The tag must face the camera within about 20° and may be turned in any direction.
    """
    grey = np.clip(photo * (255.0 / full_scale), 0, 255).astype(np.uint8)
    _, light = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    outlines, _ = cv2.findContours(light, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    ring_cells = ACROSS_CELLS - 2
    for outline in sorted(outlines, key=cv2.contourArea, reverse=True):
        centre, size_px, _ = rectangle = cv2.minAreaRect(outline)
        if min(size_px) < ring_cells * SMALLEST_CELL_PX:
            continue
        if max(size_px) > 1.3 * min(size_px):
            continue
        ring_px = cv2.boxPoints(rectangle).astype(np.float64)
        # A contour runs through the centres of the outermost bright pixels; the tag reaches a dark cell beyond the ring.
        growth = (np.mean(size_px) + 1) / np.mean(size_px) * ACROSS_CELLS / ring_cells
        corners_px = np.array(centre) + (ring_px - np.array(centre)) * growth
        readings = [read_tag(photo, np.roll(corners_px, turn, axis=0), full_scale=full_scale) for turn in range(4)]
        best = max(readings, key=lambda reading: (reading.number is not None, reading.correlation))
        if best.number is not None:
            return best
    return None


def largest_residual(cells: Float32[np.ndarray, "12 12"], number: int) -> float:
    """Return how far the worst cell is from the tag of ``number``, as a share of what a bright cell adds to itself.

    The tag is first blurred as the photo is: what a cell gets from its four neighbours and from the four diagonal ones is
    fitted together with offset and contrast.
    """
    padded = np.pad(tag_cells(number).astype(np.float64), 1)
    middle = slice(1, -1)
    beside = padded[:-2, middle] + padded[2:, middle] + padded[middle, :-2] + padded[middle, 2:]
    diagonal = padded[:-2, :-2] + padded[2:, 2:] + padded[2:, :-2] + padded[:-2, 2:]
    terms = np.column_stack([t.ravel() for t in (np.ones_like(beside), padded[middle, middle], beside, diagonal)])
    seen = cells.astype(np.float64).ravel()
    weights, *_ = np.linalg.lstsq(terms, seen, rcond=None)
    own = float(weights[1])
    return float(np.abs(seen - terms @ weights).max()) / own if own > 0 else np.inf


def _rectify(
    photo: Photo, corners_px: Corners, *, samples: int
) -> tuple[Float32[np.ndarray, "side side"], Float64[np.ndarray, "3 3"]]:
    """Return the tag and its margin as if seen straight on, ``samples`` a cell, and the matrix from there to the photo."""
    low, high = MARGIN_CELLS * samples - 0.5, (MARGIN_CELLS + ACROSS_CELLS) * samples - 0.5
    picture_px = np.array([[low, low], [high, low], [high, high], [low, high]], dtype=np.float32)
    photo_from_picture = cv2.getPerspectiveTransform(picture_px, corners_px.astype(np.float32))
    side = round((ACROSS_CELLS + 2 * MARGIN_CELLS) * samples)
    picture = cv2.warpPerspective(
        photo.astype(np.float32),
        photo_from_picture,
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # A sample then stands for the middle of a cell, half a cell wide.
    window = max(1, samples // 2)
    return cv2.blur(picture, (window | 1, window | 1)), photo_from_picture


def _places(fits: list[_Fit], *, samples: int) -> Float32[np.ndarray, "fits 12 12 2"]:
    """Return where each cell's centre is in the rectified picture, for every fit."""
    offset = (np.arange(ACROSS_CELLS) + 0.5 - ACROSS_CELLS / 2) * samples
    x, y = np.meshgrid(offset, offset)
    turn = np.array([fit.turn_rad for fit in fits])[:, None, None]
    scale = np.array([fit.scale for fit in fits])[:, None, None]
    middle = (MARGIN_CELLS + ACROSS_CELLS / 2) * samples - 0.5
    shift_x = np.array([fit.shift_x for fit in fits])[:, None, None] * samples + middle
    shift_y = np.array([fit.shift_y for fit in fits])[:, None, None] * samples + middle
    along = scale * (np.cos(turn) * x - np.sin(turn) * y) + shift_x
    down = scale * (np.sin(turn) * x + np.cos(turn) * y) + shift_y
    return np.stack([along, down], axis=-1).astype(np.float32)


def _sample_cells(
    picture: Float32[np.ndarray, "side side"], fits: list[_Fit], *, samples: int
) -> Float32[np.ndarray, "fits 12 12"]:
    places = _places(fits, samples=samples).reshape(len(fits), -1, 2)
    cells = cv2.remap(picture, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return cells.reshape(len(fits), ACROSS_CELLS, ACROSS_CELLS)


def _best_fit(picture: Float32[np.ndarray, "side side"], *, samples: int) -> _Fit:
    """Return the shift, turn and scale at which the fixed cells correlate best: a coarse search, then two finer ones.

    A place that is right already, such as that of the photo before, is only searched finely.
    """
    given = _Fit()
    best = replace(given, correlation=float(_correlations(_sample_cells(picture, [given], samples=samples))[0]))
    searches = [(1.0, 0.07, 0.08), (0.3, 0.03, 0.04), (0.1, 0.012, 0.015)]
    for reach, turn_reach_rad, scale_reach in searches if best.correlation < GOOD_CORRELATION else searches[1:]:
        shifts = np.linspace(-reach, reach, 9 if reach == 1.0 else 5)
        fits = [
            _Fit(best.shift_x + dx, best.shift_y + dy, best.turn_rad + turn, best.scale * (1 + growth))
            for dx in shifts
            for dy in shifts
            for turn in np.linspace(-turn_reach_rad, turn_reach_rad, 3)
            for growth in np.linspace(-scale_reach, scale_reach, 3)
        ]
        correlation = _correlations(_sample_cells(picture, fits, samples=samples))
        at = int(np.argmax(correlation))
        if correlation[at] > best.correlation:
            best = replace(fits[at], correlation=float(correlation[at]))
    return best


def _correlations(cells: Float32[np.ndarray, "fits 12 12"]) -> Float64[np.ndarray, " fits"]:
    """Return how well the fixed cells correlate with what they should be, -1 to 1."""
    fixed = ~data_cells()
    wanted = bright_frame_cells()[fixed].astype(np.float64)
    wanted -= wanted.mean()
    seen = cells[:, fixed].astype(np.float64)
    seen -= seen.mean(axis=1, keepdims=True)
    size = np.linalg.norm(seen, axis=1) * np.linalg.norm(wanted)
    return np.divide(seen @ wanted, size, out=np.full(len(cells), -1.0), where=size > 0)


def _corners_of(fit: _Fit, photo_from_picture: Float64[np.ndarray, "3 3"], *, samples: int) -> Corners:
    """Return the corners in the photo of the tag that was found."""
    centres = _places([fit], samples=samples)[0].astype(np.float64)
    corner_centres = centres[[0, 0, -1, -1], [0, -1, -1, 0]]
    middle = centres.mean(axis=(0, 1))
    picture_px = middle + (corner_centres - middle) * ACROSS_CELLS / (ACROSS_CELLS - 1)
    return cv2.perspectiveTransform(picture_px[None], photo_from_picture)[0]
