"""Raw photos: the samples of one colour of the sensor's filter mosaic, as they were read out, without demosaicing.

Demosaicing mixes colours and neighbours, and a developed JPEG is bent and compressed besides. Where the display shows one
primary, the samples behind filters of that colour are all there is to see.
"""

import io
from pathlib import Path

import numpy as np

from recon.errors import SessionError

SUFFIXES = frozenset({".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".pef", ".rw2"})
# White light reaches every filter; there are twice as many green ones.
FILTER_OF_PRIMARY = {"white": "G", "red": "R", "green": "G", "blue": "B"}
FULL_SCALE = 65535


def is_raw(path: Path) -> bool:
    """Whether a photo of this name is a camera's raw file."""
    return path.suffix.lower() in SUFFIXES


def decode_raw(data: bytes, path: Path, *, primary: str) -> np.ndarray:
    """Return the counts [rows, cols] (uint16) of one colour plane: half as many rows and columns as the sensor has.

    The sensor's white level becomes the top of the range; black is left in. The two green samples of each block of four are
    averaged, whose middle is the block's; a red or blue sample stands a quarter of a pixel of the plane beside it. A clipped
    sample makes its pixel clipped. Raises ``SessionError`` for a file that is no raw photo of a Bayer mosaic.
    """
    try:
        import rawpy
    except ImportError:
        raise SessionError(
            f"{path}: a raw photo needs the library rawpy; install it with `pip install 'refractive-scan[raw]'`"
        ) from None
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            mosaic = raw.raw_image_visible.copy()
            filters, letters = np.array(raw.raw_colors_visible[:2, :2]), raw.color_desc.decode("ascii")
            block = raw.raw_pattern
            white = int(raw.white_level)
    except rawpy.LibRawError as error:
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else error
        raise SessionError(f"{path}: the raw photo cannot be decoded ({reason}); take it again") from None
    names = [[letters[number] for number in row] for row in filters]
    if block is None or block.shape != (2, 2) or sorted(names[0] + names[1]) != ["B", "G", "G", "R"]:
        raise SessionError(f"{path}: the sensor has no Bayer mosaic of red, green and blue; photograph in JPEG instead")
    wanted = FILTER_OF_PRIMARY[primary]
    places = [(row, col) for row in (0, 1) for col in (0, 1) if names[row][col] == wanted]
    rows, cols = mosaic.shape[0] // 2 * 2, mosaic.shape[1] // 2 * 2
    planes = [mosaic[row:rows:2, col:cols:2] for row, col in places]
    total = sum(plane.astype(np.float64) for plane in planes)
    clipped = np.any([plane >= white for plane in planes], axis=0)
    counts = np.rint(total * (FULL_SCALE / (white * len(planes))))
    return np.where(clipped, FULL_SCALE, np.minimum(counts, FULL_SCALE - 2)).astype(np.uint16)
