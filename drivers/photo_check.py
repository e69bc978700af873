"""Is a downloaded file whole? Checked from its bytes alone, before anybody relies on it."""

JPEG_SUFFIXES = (".jpg", ".jpeg")
TIFF_SUFFIXES = (".cr2", ".nef", ".nrw", ".arw", ".dng", ".pef")
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"
TIFF_STARTS = (b"II*\0", b"MM\0*")


def fault_of_file(data: bytes, *, suffix: str, announced_bytes: int | None) -> str | None:
    """Say what is wrong with a photo's file, or return None.

    ``announced_bytes`` is the length that the camera reports for it, where it does. A body may pad its files with zeros
    behind the end of the JPEG.
    """
    if not data:
        return "is empty"
    if announced_bytes is not None and len(data) != announced_bytes:
        return f"has {len(data)} bytes, the camera announced {announced_bytes}"
    kind = suffix.lower()
    if kind in JPEG_SUFFIXES:
        if not data.startswith(JPEG_START):
            return "does not begin as a JPEG does"
        if not data.rstrip(b"\0").endswith(JPEG_END):
            return "ends before the end of its JPEG"
    elif kind in TIFF_SUFFIXES and not data.startswith(TIFF_STARTS):
        return f"does not begin as a {kind[1:].upper()} does"
    return None
