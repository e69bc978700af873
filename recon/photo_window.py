"""The part of a photo that holds some of its pixels: an object that fills a tenth of the photo needs a tenth of the memory."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True, slots=True)
class PhotoWindow:
    """Some rows and columns of a photo of ``columns`` columns."""

    rows: slice
    cols: slice
    columns: int

    @classmethod
    def about(cls, pixels: Int[np.ndarray, " pixels"], shape: tuple[int, int], *, margin_px: int) -> "PhotoWindow":
        """Return the smallest window with these pixels of a photo [rows, cols] and all that lies within a margin of them."""
        if not len(pixels):
            return cls(slice(0, 0), slice(0, 0), shape[1])
        row, col = np.divmod(pixels, shape[1])
        rows, cols = (
            slice(max(int(one.min()) - margin_px, 0), min(int(one.max()) + 1 + margin_px, size))
            for one, size in ((row, shape[0]), (col, shape[1]))
        )
        return cls(rows, cols, shape[1])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the window."""
        return self.rows.stop - self.rows.start, self.cols.stop - self.cols.start

    @property
    def part(self) -> tuple[slice, slice]:
        """The window as an index into a map of the photo."""
        return self.rows, self.cols

    def numbers(self, pixels: Int[np.ndarray, " pixels"]) -> Int[np.ndarray, " pixels"]:
        """Return the numbers that pixels of the photo have in the window, row by row."""
        row, col = np.divmod(pixels, self.columns)
        return (row - self.rows.start) * self.shape[1] + col - self.cols.start

    def on_photo(self, values: np.ndarray, rows: int, *, nothing: float) -> np.ndarray:
        """Lay a map of the window out on a photo of so many rows, which holds ``nothing`` elsewhere."""
        whole = np.full((rows, self.columns, *values.shape[2:]), nothing, dtype=values.dtype)
        whole[self.part] = values
        return whole
