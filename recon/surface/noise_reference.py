"""The noise of windows' normals from few draws: what it is over what went in differs little over a surface."""

from dataclasses import dataclass

import cv2
import numpy as np

from recon.surface.ray_chords import Mask, ScalarMap

# Pixels as deep inside the surface are alike where windows are cut or lean on cut ones; all deeper ones are.
DEPTHS_PX = (1, 2, 3, 4, 5, 6, 7, 8)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseReference:
    """What the noise of windows is compared with: the errors of normals that went into the draws, by the depth of a pixel.

    An sd from a dozen draws near a pixel errs by several per cent, and pixels that seem the surest are those where it errs low.
    The share of the noise that a window leaves is the same wherever windows are alike, and needs no place of its own. Only pixels
    ``within`` the tile tell of it: the windows of those in its border are cut by the tile.
    """

    turn_sd_rad: ScalarMap
    depth_px: ScalarMap
    within: Mask

    def smoothed(self, squares: ScalarMap, slope_variance: ScalarMap, mask: Mask, *, half_width: int) -> ScalarMap:
        """Return the variance of windows' normals from the mean squares of draws.

        ``slope_variance`` is that for heights of variance one: a window with few places, or all on a line, says less than others.
        Where it is less than typical, that is not so of the noise, which neighbours share.
        """
        told = mask & self.within
        if not told.any():
            return np.full(mask.shape, np.nan)
        whole = told & (self.depth_px > half_width)
        typical = float(np.median(slope_variance[whole if whole.any() else told]))
        reference = self.turn_sd_rad**2 * np.maximum(slope_variance / typical, 1.0)
        depth = np.searchsorted(DEPTHS_PX, self.depth_px)
        count = np.bincount(depth[told], minlength=len(DEPTHS_PX) + 1)
        total = np.bincount(depth[told], squares[told] / reference[told], minlength=len(DEPTHS_PX) + 1)
        return np.where(told, reference * (total / np.maximum(count, 1))[depth], np.nan)


def depth_of(mask: Mask) -> ScalarMap:
    """Return how many steps, also diagonal ones, lead from a pixel out of the surface; the photo's edge is no way out."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_C, 3), np.float64)
