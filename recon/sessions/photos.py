"""Read photos as grey counts: JPEG straight into a reused buffer, raw files one colour plane, the rest through OpenCV."""

from pathlib import Path

import cv2
import numpy as np
import simplejpeg

from recon.errors import SessionError
from recon.sessions.raw_photos import decode_raw, is_raw

Counts = np.ndarray  # [rows, cols] uint8 or uint16

FULL_RANGE = 1 << 16
# That of 8 bits. Fewer levels than theirs have a larger step by chance.
LARGEST_SHIFTED_STEP = 1 << 8

# The plane of a decoded BGR photo that a display showing one primary lights.
PLANE_OF_PRIMARY = {"blue": 0, "green": 1, "red": 2}


def read_grey(path: Path, *, rows: int, cols: int, primary: str = "white", buffer: np.ndarray | None = None) -> Counts:
    """Return the photo's counts [rows, cols], uint8 or uint16; ``buffer`` is reused where the photo is a grey JPEG.

    A display that shows one primary is decoded from that colour plane alone. Raises ``SessionError`` for a photo that
    is missing, truncated, not a picture, or of another size.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise SessionError(f"{path}: the photo is missing; restore it or take it again") from None
    except OSError as error:
        raise SessionError(f"{path}: the photo cannot be read ({error.strerror})") from None
    counts = decode_grey(data, path, primary=primary, buffer=buffer)
    if counts.shape != (rows, cols):
        raise SessionError(
            f"{path}: the photo is {counts.shape[1]} x {counts.shape[0]} px, the manifest says {cols} x {rows}"
        )
    return counts


def decode_grey(data: bytes, path: Path, *, primary: str = "white", buffer: np.ndarray | None = None) -> Counts:
    """Return the counts of a photo that is in memory; ``path`` names it in errors. Else as :func:`read_grey`."""
    if is_raw(path):
        return decode_raw(data, path, primary=primary)
    if data[:2] == b"\xff\xd8":
        return _decode_jpeg(data, path, primary=primary, buffer=buffer)
    return _decode_other(data, path, primary=primary)


def _decode_jpeg(data: bytes, path: Path, *, primary: str, buffer: np.ndarray | None) -> Counts:
    try:
        if primary in PLANE_OF_PRIMARY:
            colours = simplejpeg.decode_jpeg(data, "BGR")
            return np.ascontiguousarray(colours[:, :, PLANE_OF_PRIMARY[primary]])
        height, width, _, _ = simplejpeg.decode_jpeg_header(data)
        fits = buffer is not None and buffer.shape == (height, width)
        return simplejpeg.decode_jpeg(data, "GRAY", buffer=buffer if fits else None).reshape(height, width)
    except ValueError as error:
        raise SessionError(f"{path}: the photo is truncated or damaged ({error}); take it again") from None


def _decode_other(data: bytes, path: Path, *, primary: str) -> Counts:
    counts = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if counts is None:
        raise SessionError(
            f"{path}: not a photo that can be decoded (JPEG, PNG, TIFF and raw files can); take it again"
        )
    if counts.ndim == 3 and primary in PLANE_OF_PRIMARY:
        counts = np.ascontiguousarray(counts[:, :, PLANE_OF_PRIMARY[primary]])
    elif counts.ndim == 3:
        counts = cv2.cvtColor(counts[:, :, :3], cv2.COLOR_BGR2GRAY)
    if counts.dtype not in (np.uint8, np.uint16):
        raise SessionError(f"{path}: samples of type {counts.dtype}; 8 or 16 bits a sample are expected")
    return np.asarray(counts)


def saturation_count(counts: Counts) -> int:
    """Return the count from which a sample is taken as clipped: the top of the range less one step, for JPEG ringing.

    Fewer bits that a camera or a program shifted up to 16 end in as many zeros, all of them, and their top is lower: 65520
    for 12 bits. ``counts`` should be a photo with light in it: where all samples are 0, steps are taken to be one.
    """
    if counts.dtype == np.uint8:
        return 254
    bits = int(np.bitwise_or.reduce(counts, axis=None))
    step = min(bits & -bits, LARGEST_SHIFTED_STEP) if bits else 1
    return FULL_RANGE - 2 * step
