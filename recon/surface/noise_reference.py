"""The noise of windows' normals from few draws: what it is over what went in differs little over a surface."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product

import cv2
import numpy as np
from jaxtyping import Float64

from recon.surface.ray_chords import Mask, ScalarMap

# Pixels as deep inside the surface are alike where windows are cut or lean on cut ones; all deeper ones are.
DEPTHS_PX = (1, 2, 3, 4, 5, 6, 7, 8)
LEAST_TOTAL = float(np.finfo(float).tiny)

# For each window, how many pixels of a depth told of their noise, and the sum of what they told.
Shares = Float64[np.ndarray, "windows 2 depths"]


@dataclass(frozen=True, slots=True, eq=False)
class NoiseReference:
    """What the noise of windows is compared with: the errors of normals that went into the draws, by the depth of a pixel.

    An sd from a dozen draws near a pixel errs by several per cent, and pixels that seem the surest are those where it errs low.
    The share of the noise that a window leaves is the same wherever windows are alike, and needs no place of its own. Only pixels
    ``within`` the tile tell of it: the windows of those in its border are cut by the tile. What each window's told is kept.
    """

    turn_sd_rad: ScalarMap
    depth_px: ScalarMap
    within: Mask
    told: list[Float64[np.ndarray, "2 depths"]] = field(default_factory=list)

    def smoothed(self, squares: ScalarMap, slope_variance: ScalarMap, mask: Mask, *, half_width: int) -> ScalarMap:
        """Return the variance of windows' normals from the mean squares of draws.

        ``slope_variance`` is that for heights of variance one: a window with few places, or all on a line, says less than others.
        Where it is less than typical, that is not so of the noise, which neighbours share.
        """
        told = mask & self.within
        if not told.any():
            self.told.append(np.zeros((2, len(DEPTHS_PX) + 1)))
            return np.full(mask.shape, np.nan)
        whole = told & (self.depth_px > half_width)
        typical = float(np.median(slope_variance[whole if whole.any() else told]))
        reference = self.turn_sd_rad**2 * np.maximum(slope_variance / typical, 1.0)
        depth = depth_class(self.depth_px)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = squares / reference
        # A window that tells hardly anything may turn beyond all numbers, and must not speak for the others.
        tells = told & np.isfinite(share)
        count = np.bincount(depth[tells], minlength=len(DEPTHS_PX) + 1)
        total = np.bincount(depth[tells], share[tells], minlength=len(DEPTHS_PX) + 1)
        self.told.append(np.stack([count, total]))
        return np.where(told, reference * (total / np.maximum(count, 1))[depth], np.nan)


def depth_class(depth_px: ScalarMap) -> np.ndarray:
    """Return which of the depths that are told apart each pixel has."""
    return np.searchsorted(DEPTHS_PX, depth_px)


def steadied(told: Mapping[tuple[int, int], Shares]) -> dict[tuple[int, int], Float64[np.ndarray, "windows depths"]]:
    """Return by how much the shares of noise over the tiles about each, by row and column of tiles, are larger than its own.

    A tile's draws tell its share to some five per cent. That error is the same for all of its pixels of a depth, which would
    seem surer than others for it.
    """
    result = {}
    for row, col in told:
        about = product((row - 1, row, row + 1), (col - 1, col, col + 1))
        near = [told[place] for place in about if place in told]
        count, total = np.moveaxis(np.sum(near, axis=0), 1, 0)
        own_count, own_total = np.moveaxis(told[row, col], 1, 0)
        # Σ total / Σ count over the same of the tile itself; 1 where that told of nothing.
        larger = total * own_count / np.maximum(count * own_total, LEAST_TOTAL)
        result[row, col] = np.where(own_total > 0, larger, 1.0)
    return result


def straight_depth_of(mask: Mask) -> ScalarMap:
    """Return how far a pixel is from the next one out of the surface, in pixels; the photo's edge is no way out.

    OpenCV's last digits follow from where in memory the mask happens to lie. The squared distance is a whole number, which up to
    a thousand pixels it tells beyond doubt.
    """
    told = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(np.sqrt(np.rint(told.astype(np.float64) ** 2)))


def depth_of(mask: Mask) -> ScalarMap:
    """Return how many steps, also diagonal ones, lead from a pixel out of the surface; the photo's edge is no way out."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_C, 3), np.float64)
