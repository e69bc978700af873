"""Which part of the camera grid is shown, and how much of it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of the camera grid and the step at which it is shown."""

    row_start: int
    row_stop: int
    col_start: int
    col_stop: int
    step: int

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Edges in camera pixels for ``imshow``: left, right, bottom, top."""
        return (self.col_start - 0.5, self.col_stop - 0.5, self.row_stop - 0.5, self.row_start - 0.5)

    def part(self, grid: np.ndarray) -> np.ndarray:
        """Return the part of a map, with every pixel of it."""
        return grid[self.row_start : self.row_stop, self.col_start : self.col_stop]

    def cut(self, grid: np.ndarray) -> np.ndarray:
        """Return the part of a map, thinned to the step."""
        return self.part(grid)[:: self.step, :: self.step]


def window_around(wanted: Bool[np.ndarray, "rows cols"], *, longest_px: int) -> Window:
    """Return the rectangle that holds every wanted pixel with a little room, thinned to ``longest_px``."""
    rows, cols = (np.flatnonzero(wanted.any(axis=axis)) for axis in (1, 0))
    if rows.size == 0:
        bounds = (0, wanted.shape[0], 0, wanted.shape[1])
    else:
        room = 2 + max(np.ptp(rows), np.ptp(cols)) // 40
        bounds = (
            max(0, int(rows[0] - room)),
            min(wanted.shape[0], int(rows[-1] + room + 1)),
            max(0, int(cols[0] - room)),
            min(wanted.shape[1], int(cols[-1] + room + 1)),
        )
    longest = max(bounds[1] - bounds[0], bounds[3] - bounds[2])
    return Window(*bounds, step=max(1, -(-longest // longest_px)))
