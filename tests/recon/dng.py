"""A minimal DNG (Adobe's specification 1.4): an uncompressed mosaic of 16-bit samples that LibRaw opens as a camera's raw."""

import struct

import numpy as np

SHORT, LONG, RATIONAL, BYTE, ASCII, SRATIONAL = 3, 4, 5, 1, 2, 10
SIZE = {BYTE: 1, ASCII: 1, SHORT: 2, LONG: 4, RATIONAL: 8, SRATIONAL: 8}
RED, GREEN, BLUE = 0, 1, 2


def dng_bytes(
    mosaic: np.ndarray,
    *,
    colours: tuple[int, int, int, int] = (RED, GREEN, GREEN, BLUE),
    black: int = 0,
    white: int = 16383,
) -> bytes:
    """Return a DNG whose samples [rows, cols] (uint16) lie under ``colours``, the first two rows' first two filters."""
    rows, cols = mosaic.shape
    data = mosaic.astype("<u2").tobytes()
    identity = [value for k in range(9) for value in (int(k % 4 == 0), 1)]
    entries = [
        (254, LONG, [0]),  # the main picture
        (256, LONG, [cols]),
        (257, LONG, [rows]),
        (258, SHORT, [16]),
        (259, SHORT, [1]),  # uncompressed
        (262, SHORT, [32803]),  # colour filter array
        (271, ASCII, list(b"Nobody\0")),
        (272, ASCII, list(b"Mosaic\0")),
        (273, LONG, [0]),  # where the samples begin, filled in below
        (274, SHORT, [1]),
        (277, SHORT, [1]),
        (278, LONG, [rows]),
        (279, LONG, [len(data)]),
        (284, SHORT, [1]),
        (33421, SHORT, [2, 2]),
        (33422, BYTE, list(colours)),
        (50706, BYTE, [1, 4, 0, 0]),  # DNG version
        (50707, BYTE, [1, 1, 0, 0]),
        (50708, ASCII, list(b"Nobody Mosaic\0")),
        (50714, LONG, [black]),
        (50717, LONG, [white]),
        (50721, SRATIONAL, identity),
        (50728, RATIONAL, [1, 1, 1, 1, 1, 1]),
        (50778, SHORT, [21]),
    ]
    directory_at = 8
    extra_at = directory_at + 2 + 12 * len(entries) + 4
    letters = {BYTE: "B", ASCII: "B", SHORT: "H", LONG: "I", RATIONAL: "I", SRATIONAL: "i"}
    packed = {tag: struct.pack(f"<{len(values)}{letters[kind]}", *values) for tag, kind, values in entries}
    samples_at = extra_at + sum(len(value) + len(value) % 2 for value in packed.values() if len(value) > 4)
    packed[273] = struct.pack("<I", samples_at)
    directory, extra = struct.pack("<H", len(entries)), b""
    for tag, kind, _ in entries:
        value = packed[tag]
        place = value.ljust(4, b"\0") if len(value) <= 4 else struct.pack("<I", extra_at + len(extra))
        if len(value) > 4:
            extra += value + b"\0" * (len(value) % 2)
        directory += struct.pack("<HHI", tag, kind, len(value) // SIZE[kind]) + place
    return struct.pack("<2sHI", b"II", 42, directory_at) + directory + struct.pack("<I", 0) + extra + data
