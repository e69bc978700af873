"""How many sweeps are decoded at the same time: one a core, and no more than the memory that is free will hold."""

import os
from pathlib import Path

from recon.method import Method
from recon.sessions.session import Session

# Bytes a pixel of the photo, found with `recon bench`: what stays of a sweep, what one takes while it is decoded,
# and how much of that for each byte of a sample (photos and windows about the peaks).
KEPT = {"paper": 9, "full": 9}
DECODING = {"paper": 10, "full": 45}
DECODING_A_SAMPLE_BYTE = {"paper": 10, "full": 35}
# The stages that follow, and other programs, want memory too.
USABLE_SHARE = 0.7
MEMORY_FILE = Path("/proc/meminfo")
# The limit of a container or of a cluster's queue (control groups, version 2).
LIMIT_FILE = Path("/sys/fs/cgroup/memory.max")


def free_memory_bytes() -> int:
    """Return the memory that this process may still take; where the system does not tell, all that the machine has."""
    free = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if MEMORY_FILE.is_file():
        for line in MEMORY_FILE.read_text(encoding="ascii").splitlines():
            name, _, value = line.partition(":")
            if name == "MemAvailable":
                free = 1024 * int(value.split()[0])
    limit = LIMIT_FILE.read_text(encoding="ascii").strip() if LIMIT_FILE.is_file() else "max"
    return free if limit == "max" else min(free, int(limit))


def threads_that_fit(
    *, cores: int, sweeps: int, pixels: int, sample_bytes: int, method: Method, memory_bytes: int
) -> int:
    """Return how many sweeps of so many pixels can be decoded at a time; at least one.

    Examples
    --------
    Eight sweeps of 10 megapixels, in 4 GB and in 64 GB:

    >>> sweep = dict(cores=16, sweeps=8, pixels=10_000_000, sample_bytes=1, method="full")
    >>> threads_that_fit(**sweep, memory_bytes=4_000_000_000), threads_that_fit(**sweep, memory_bytes=64_000_000_000)
    (2, 8)
    """
    one = pixels * (DECODING[method] + DECODING_A_SAMPLE_BYTE[method] * sample_bytes)
    spare = USABLE_SHARE * memory_bytes - sweeps * pixels * KEPT[method]
    return max(min(cores, sweeps, int(spare // one)), 1)


def decoding_threads(session: Session, *, method: Method, cores: int) -> int:
    """Return how many of a session's sweeps are decoded at a time on so many cores."""
    camera = session.manifest.camera
    first = session.manifest.sets[0]
    photo = session.photo_file(first.name, "x", session.photo_numbers(first, "x").start)
    return threads_that_fit(
        cores=cores,
        sweeps=sum(len(one.sweeps) for one in session.manifest.sets),
        pixels=camera.rows * camera.columns,
        sample_bytes=1 if photo.suffix.lower() in (".jpg", ".jpeg") else 2,
        method=method,
        memory_bytes=free_memory_bytes(),
    )
