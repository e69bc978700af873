"""The frame tag: the number of the frame, drawn in a corner of the display where the camera sees it directly.

Read back from a photo it proves that the photo shows the frame that was commanded, and not the one before, another one, or
two of them in turn. What a tag looks like is here; how it is read back is in ``frame_tag_reading.py``.

::

    . . . . . . . . . . . .      12 × 12 square cells. The outermost are dark. Inside them runs a bright ring, whose
    . . . # # # # # # # # .      first two cells are dark, so that no rotation and no mirror image looks the same.
    . # d d d d d d d d # .      Within are 8 rows of 4 pairs of cells (d): bright, dark is a 1; dark, bright is a 0.
    . # d d d d d d d d # .      Row by row these are the 16 bits of the number and 16 check bits, highest first.
      ...
    . # # # # # # # # # # .
    . . . . . . . . . . . .

A pair is told by which of its cells is the brighter, whatever the exposure; and every tag lights the same number of cells,
so that what it sheds on the object is the same in every photo. The check bits are the remainder of a division by
``POLYNOMIAL``: any two of the 65,536 tags differ in at least 7 of their 32 pairs. (Marker families such as ArUco's hold a
thousand numbers or fewer, a capture has three thousand frames.)
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, UInt8

ACROSS_CELLS = 12
DATA_CELLS = 8
FIRST_DATA_CELL = 2
NUMBER_BITS = 16
LARGEST_NUMBER = 2**NUMBER_BITS - 1
# x^16 + x^8 + x^7 + x^5 + x^4 + x^3 + 1: of all polynomials of degree 16 one with the largest distance, 7, at this length.
POLYNOMIAL = 0x101B9
BRIGHT_LEVEL = 255


@dataclass(frozen=True, slots=True)
class TagPlace:
    """Where the tag is on the display: the device pixel of its top-left corner, and the side of a cell in device pixels."""

    column: int
    row: int
    cell_px: int

    @property
    def side_px(self) -> int:
        """Width and height of the whole tag in device pixels; stripes never enter it."""
        return ACROSS_CELLS * self.cell_px

    def covers(self, *, columns: tuple[float, float], rows: tuple[float, float]) -> bool:
        """Whether the tag overlaps a rectangle of the display, given by its first and last device pixel each way."""
        return (
            columns[0] < self.column + self.side_px
            and columns[1] > self.column - 1
            and rows[0] < self.row + self.side_px
            and rows[1] > self.row - 1
        )


def tag_levels(number: int, *, cell_px: int) -> UInt8[np.ndarray, "side_px side_px"]:
    """Return the drive levels of the tag of ``number`` (0 to 65535); raises ``ValueError`` for any other number."""
    cells = np.where(tag_cells(number), BRIGHT_LEVEL, 0).astype(np.uint8)
    return np.repeat(np.repeat(cells, cell_px, axis=0), cell_px, axis=1)


def tag_cells(number: int) -> Bool[np.ndarray, "12 12"]:
    """Return which cells of the tag of ``number`` are bright."""
    if not 0 <= number <= LARGEST_NUMBER:
        raise ValueError(f"a frame tag holds a number from 0 to {LARGEST_NUMBER}, not {number}")
    cells = bright_frame_cells()
    word = number << NUMBER_BITS | check_bits(number)
    last = DATA_CELLS * DATA_CELLS // 2 - 1
    for pair in range(last + 1):
        row, left = divmod(pair, DATA_CELLS // 2)
        bit = word >> (last - pair) & 1
        cells[FIRST_DATA_CELL + row, FIRST_DATA_CELL + 2 * left + (1 - bit)] = True
    return cells


def bright_frame_cells() -> Bool[np.ndarray, "12 12"]:
    """Return the bright cells that every tag has: the ring, without its first two cells."""
    cells = np.zeros((ACROSS_CELLS, ACROSS_CELLS), dtype=bool)
    cells[1:-1, 1:-1] = True
    cells[data_cells()] = False
    cells[1, 1:3] = False
    return cells


def data_cells() -> Bool[np.ndarray, "12 12"]:
    """Return the cells that hold the number; all others are the same in every tag."""
    cells = np.zeros((ACROSS_CELLS, ACROSS_CELLS), dtype=bool)
    inside = slice(FIRST_DATA_CELL, FIRST_DATA_CELL + DATA_CELLS)
    cells[inside, inside] = True
    return cells


def check_bits(number: int) -> int:
    """Return the remainder of ``number`` · x^16 divided by the polynomial, over the field of two elements."""
    remainder = number << NUMBER_BITS
    for bit in range(2 * NUMBER_BITS - 1, NUMBER_BITS - 1, -1):
        if remainder >> bit & 1:
            remainder ^= POLYNOMIAL << (bit - NUMBER_BITS)
    return remainder


def number_of(bits: Bool[np.ndarray, " 32"]) -> int | None:
    """Return the number that 32 bits carry, highest first, or None when the check bits disagree."""
    word = int("".join("1" if bit else "0" for bit in bits), 2)
    number, check = divmod(word, 2**NUMBER_BITS)
    return number if check_bits(number) == check else None
