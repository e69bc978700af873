"""Whether the disk has room for the photos that a capture still has to take."""

import shutil
from pathlib import Path

# A disk that is filled to the last byte upsets more than this program.
DISK_RESERVE_BYTES = 200_000_000


def disk_fault(folder: Path, *, photo_mb: float, photos: int = 1) -> str | None:
    """Say that there is no room for so many photos, or None where there is."""
    needed_bytes = photos * photo_mb * 1e6
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes >= needed_bytes + DISK_RESERVE_BYTES:
        return None
    return (
        f"{folder}: the photos will take about {needed_bytes / 1e9:.1f} GB, {free_bytes / 1e9:.1f} GB are free; "
        "make room or choose another disk"
    )
