"""Where within a display pixel a camera pixel looks, told by its neighbours.

A display shows a stripe in steps, one level a device pixel. A camera pixel whose footprint lies within one device pixel sees
the same curve wherever in it that is: its likelihood is flat over an interval, its place the interval's middle, and the error
a sawtooth of the true place, alike in all neighbours that look at the same device pixels. Averages do not take it away, and
what hangs on small differences (the liquid's index, registration) takes it for truth.

But the footprints of some neighbours straddle two device pixels, and their curves tell to a hundredth of a pixel where. The map
from camera to display is smooth, so a quadratic surface through a window (:mod:`recon.sweeps.block_surfaces`), each place
weighted by what its curve tells, says where in their intervals the others look; a cubic one, where the map's bend changes. What
a pixel's own curve told is not given up: no place leaves its interval, none moves where the neighbourhood is not smooth, and
places known as well as their neighbours' stay as they are. Beside an edge, where photos are compressed with errors that a
smooth surface would follow, nothing is told. A pixel that all its neighbours contradict is less sure than its curve says.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np

from recon.sweeps.block_surfaces import TERMS, Grid, Mask, Tile, block_surfaces, weight_of

# A block's window, it and its eight neighbours, must see some four device pixels, or hardly any footprint in it straddles two;
# where it knows too little a larger one is asked.
BLOCKS_PX = (3, 5, 8)
WINDOW_REACH_PX = 4.0
# A place is told where its window knows places so many times better, each of them on average and the one by all together.
FAR_BETTER = 2.0
# The end of an interval, in standard deviations of a place that lies anywhere in it.
INTERVAL_END_SD = np.sqrt(3.0)
BEYOND_END_SIGMA = 3.0
# A pixel that makes so much of its window's chi-square alone is off. That is looked for so many times: one hides another.
ALONE_SHARE = 0.3
ALONE_ROUNDS = 3
# Of whole blocks of every size.
TILE_PX = 240


def told_by_neighbours(place_px: Grid, sd_px: Grid, *, trusted: Mask, reach_px: Grid) -> tuple[Grid, Grid]:
    """Return places and sds in device pixels, those of flat likelihoods settled within their intervals where neighbours can.

    Parameters
    ----------
    place_px, sd_px
        Maps in device pixels, NaN where there is no place.
    trusted
        Pixels that saw one stripe, by one path: they alone tell and are told.
    reach_px
        How far the footprint of a pixel reaches along the display's axis, NaN where its likelihood is not flat.

    Notes
    -----
    The sd of a pixel that makes a window rough alone is widened by what it is off, so that it does not speak for the others.
    A new sd is the surface's, widened by its roughness, and in quadrature an even share of what the window knows: what is
    told adds nothing to what neighbours know, and must not count many times where places are averaged as independent.
    """
    usable = trusted & np.isfinite(place_px) & (sd_px > 0)
    waiting = usable & (reach_px >= 0)
    if not waiting.any():
        return place_px, sd_px
    sd_px = _widened_alone(place_px, sd_px, usable, waiting)
    place, sd = place_px.copy(), sd_px.copy()
    for degree, block_px in product(TERMS, BLOCKS_PX):
        # The largest window is tried whatever the reach.
        smallest_px = WINDOW_REACH_PX / (3 * block_px) if block_px < BLOCKS_PX[-1] else 0.0
        for tile in _tiles(place.shape):
            asking = waiting[tile] & (reach_px[tile] >= smallest_px)
            if not asking.any():
                continue
            surfaces = block_surfaces(place_px, sd_px, usable, tile, block_px=block_px, degree=degree)
            own, own_sd = place_px[tile], sd_px[tile].astype(np.float64)
            told, told_sd, share, rough = surfaces.in_pixels(own.shape)
            with np.errstate(invalid="ignore"):
                end = INTERVAL_END_SD * own_sd
                agreed = asking & ~rough & (FAR_BETTER * np.maximum(told_sd, share) < own_sd)
                agreed &= np.abs(told - own) < end + BEYOND_END_SIGMA * told_sd
            np.copyto(place[tile], np.clip(told, own - end, own + end), where=agreed)
            np.copyto(sd[tile], np.hypot(told_sd, share), where=agreed, casting="same_kind")
            waiting[tile] &= ~agreed
    return place, sd


def _tiles(size: tuple[int, int]) -> Iterator[Tile]:
    for top, left in product(range(0, size[0], TILE_PX), range(0, size[1], TILE_PX)):
        yield slice(top, min(top + TILE_PX, size[0])), slice(left, min(left + TILE_PX, size[1]))


def _widened_alone(place_px: Grid, sd_px: Grid, usable: Mask, waiting: Mask) -> Grid:
    """Return sds widened by what pixels are off that make most of their small windows' chi-square alone."""
    block_px, sd_px = BLOCKS_PX[0], sd_px.copy()
    for tile in _tiles(place_px.shape):
        for _ in range(ALONE_ROUNDS if waiting[tile].any() else 0):
            surfaces = block_surfaces(place_px, sd_px, usable, tile, block_px=block_px, degree=min(TERMS))
            own = place_px[tile]
            off = surfaces.places(own.shape) - own
            with np.errstate(invalid="ignore"):
                own_misfit = off**2 * weight_of(sd_px[tile], usable[tile], block_px)
            alone = own_misfit > ALONE_SHARE * surfaces.misfit_where_rough(own.shape)
            if not alone.any():
                break
            np.copyto(sd_px[tile], np.hypot(sd_px[tile], off), where=alone, casting="same_kind")
    return sd_px
