"""Which neighbours the measurements hold together: depth jumps where they say so, and pixels that stand against all others.

Two neighbours whose chord lies outside both their tangent planes, by far more than the noise of distances and normals, do
not lie on one surface. What is left connected are sheets. A few pixels that agree with none
of those about them are not a sheet but outliers.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import maximum_filter, minimum_filter

from recon.surface.neighbours import Neighbours, components
from recon.surface.ray_chords import Chords, PerPair, PerPixel, Rays

# Gaussian noise contradicts itself by so many sd once in two million pairs.
JUMP_SD = 5.0
# Pixels that fill no window of this size, such as a row along an edge, cannot show that they are a surface.
SMALLEST_SHEET_PX = 3
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
    between = 0.5 * np.abs((turn * chords.chord_mm).sum(axis=1))
    beyond = np.abs(chords.residual(graph, rays.measured_mm)) - between
    against = np.maximum(beyond, 0.0) / _noise_sd(chords, graph, rays)
    # Standard deviations that promise too much everywhere are no reason to cut.
    typical = NORMAL_CONSISTENT_MAD * float(np.median(against[known])) if known.any() else 1.0
    apart = known & (against > JUMP_SD * max(1.0, typical))
    sheet = components(graph.pixels, graph.first[~apart], graph.second[~apart])
    small = ~_fills_window(sheet, graph)
    part = components(graph.pixels, graph.first, graph.second)
    outlier = small & (np.bincount(part, ~small)[part] > 0)
    return Sheets(jump=apart & ~outlier[graph.first] & ~outlier[graph.second], outlier=outlier)


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
