"""A map in tiles, so that work on it needs memory for one tile at a time and has a plane of its own in each."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool

Mask = Bool[np.ndarray, "rows cols"]
Part = tuple[slice, slice]

TILE_PX = 64


def tiles(used: Mask, *, border: int) -> Iterator[tuple[Part, Part]]:
    """Yield the tiles that hold any used pixel, each with the same tile widened by ``border`` pixels."""
    rows, columns = used.shape
    for top in range(0, rows, TILE_PX):
        for left in range(0, columns, TILE_PX):
            core = (slice(top, min(top + TILE_PX, rows)), slice(left, min(left + TILE_PX, columns)))
            if used[core].any():
                yield core, (_widened(core[0], border, rows), _widened(core[1], border, columns))


def _widened(part: slice, border: int, size: int) -> slice:
    return slice(max(part.start - border, 0), min(part.stop + border, size))


def inside(core: Part, wide: Part) -> Part:
    """Return the core in the coordinates of the widened tile."""
    first, second = (slice(c.start - w.start, c.stop - w.start) for c, w in zip(core, wide, strict=True))
    return first, second
