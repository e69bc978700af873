"""Which neighbours the measurements hold together: depth jumps where they say so, and pixels that stand against all others.

Two neighbours whose chord lies outside both their tangent planes, by far more than the noise of distances and normals, do
not lie on one surface. Where a jump is smaller, many pairs along it may tell what one does not (``long_jumps``). What is left
connected are sheets. A few pixels that agree with none
of those about them are not a sheet but outliers.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import maximum_filter, minimum_filter

from recon.surface.long_jumps import DEEP_PX, LONG_PX, long_jumps
from recon.surface.neighbours import Neighbours, components, parts_of
from recon.surface.ray_chords import Chords, PerPair, PerPixel, Rays

# Gaussian noise contradicts itself by so many sd once in two million pairs.
JUMP_SD = 5.0
# Pixels that fill no window of this size, such as a row along an edge, cannot show that they are a surface.
SMALLEST_SHEET_PX = 3
# Along an edge that parts a surface, half of the pairs show more than that.
SURE_EDGE_SD = 5.0
# As many pixels as say of one edge on which side the surface stands.
SMALLEST_PART_PX = DEEP_PX * LONG_PX
NORMAL_CONSISTENT_MAD = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class Sheets:
    """The pairs that join two sheets (``jump``), and the pixels of a connected part that belong to none of its sheets."""

    jump: Bool[np.ndarray, " pairs"]
    outlier: Bool[np.ndarray, " pixels"]


def sheets_of(chords: Chords, graph: Neighbours, rays: Rays) -> Sheets:
    """Part the pixels into sheets by their own measurements; ``chords`` are those for a surface at these.

    A pixel without a distance of its own contradicts nobody.
    """
    measured = rays.precision > 0
    known = measured[graph.first] & measured[graph.second]
    # On a smooth surface, and across a crease, a chord lies between the tangent planes of its two ends.
    turn = rays.normal[graph.second] - rays.normal[graph.first]
    between = 0.5 * np.abs(np.einsum("pi,pi->p", turn, chords.chord_mm))
    beyond = np.abs(chords.residual(graph, rays.measured_mm)) - between
    against = np.maximum(beyond, 0.0) / _noise_sd(chords, graph, rays)
    # Standard deviations that promise too much everywhere are no reason to cut.
    typical = NORMAL_CONSISTENT_MAD * float(np.median(against[known])) if known.any() else 1.0
    apart = known & (against > JUMP_SD * max(1.0, typical))
    part = parts_of(graph.mask)
    sheet = components(graph.pixels, graph.first[~apart], graph.second[~apart]) if apart.any() else part
    small = ~_fills_window(sheet, graph)
    outlier = small & (np.bincount(part, ~small)[part] > 0)
    return Sheets(jump=apart & ~outlier[graph.first] & ~outlier[graph.second], outlier=outlier)


def with_long_jumps(sheets: Sheets, graph: Neighbours, rays: Rays, distance: PerPixel, *, threads: int = 1) -> Sheets:
    """Part the sheets further along edges that show only all together: the distances leave jumps of a surface at ``distance``.

    With several ``threads``, edges between columns and edges between rows are sought at the same time.
    """
    left_mm, precision = graph.on_grid(rays.measured_mm - distance), graph.on_grid(rays.precision)
    right, below = long_jumps(np.nan_to_num(left_mm), np.nan_to_num(precision), threads=threads)
    along, down = graph.mask[:, :-1] & graph.mask[:, 1:], graph.mask[:-1] & graph.mask[1:]
    size_sd = np.concatenate([right[:, :-1][along], below[:-1][down]])
    new = (size_sd != 0) & ~sheets.jump
    if not new.any():
        return sheets
    # Errors that neighbours share make edges too, but hardly one that parts a surface from rim to rim, sure on most of its way.
    part = components(graph.pixels, graph.first[~sheets.jump & ~new], graph.second[~sheets.jump & ~new])
    one, other = part[graph.first], part[graph.second]
    large = np.bincount(part, rays.precision > 0) >= SMALLEST_PART_PX
    between = np.flatnonzero(new & (one != other) & large[one] & large[other])
    border = np.minimum(one, other)[between].astype(np.int64) * (int(part.max(initial=0)) + 1)
    border += np.maximum(one, other)[between]
    sure = np.zeros(len(new), dtype=bool)
    for number in np.unique(border):
        pairs = between[border == number]
        sizes = size_sd[pairs][np.isfinite(size_sd[pairs])]
        sure[pairs] = len(sizes) > 0 and float(np.median(sizes)) > SURE_EDGE_SD
    return Sheets(sheets.jump | sure, sheets.outlier)


def _fills_window(sheet: np.ndarray, graph: Neighbours) -> Bool[np.ndarray, " pixels"]:
    """Tell of each pixel whether the sheet that it is on fills a window somewhere."""
    number = np.full(graph.mask.shape, -1)
    number[graph.mask] = sheet
    same = minimum_filter(number, SMALLEST_SHEET_PX, mode="constant", cval=-1) == maximum_filter(
        number, SMALLEST_SHEET_PX, mode="constant", cval=-1
    )
    inside = number[same & graph.mask]
    return np.bincount(inside, minlength=int(sheet.max(initial=-1)) + 1)[sheet] > 0


def contradiction(chords: Chords, graph: Neighbours, rays: Rays, distance: PerPixel) -> PerPair:
    """Return by how many sd, with those of the measured distances, a surface at ``distance`` leaves each chord's plane."""
    return chords.residual(graph, distance) / _noise_sd(chords, graph, rays)


def _noise_sd(chords: Chords, graph: Neighbours, rays: Rays) -> PerPair:
    variance = np.divide(1.0, rays.precision, out=np.full(graph.pixels, np.inf), where=rays.precision > 0)
    noise = chords.at_first**2 * variance[graph.first] + chords.at_second**2 * variance[graph.second]
    return np.sqrt(chords.variance + noise)
