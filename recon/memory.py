"""Memory that is free inside the process, and how the system gets it back; memory that is taken page by page."""

import ctypes
import math
import mmap
from collections.abc import Callable
from functools import cache

import numpy as np


def give_back_free_memory() -> None:
    """Return what the allocator holds free to the system.

    The GNU C library keeps arrays of up to 32 MB for itself once such arrays have been freed, in pieces between others, so that
    a process grows by as much again as it uses. Where it has no ``malloc_trim`` (other C libraries), nothing is done.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


def zeros_taken_when_written(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Return zeros of a shape, of which only the pages that are written to are ever taken.

    NumPy's own zeros do the same where they are fresh from the system; those that the allocator had before are written at once.
    """
    size = math.prod(shape)
    return np.frombuffer(mmap.mmap(-1, max(size * np.dtype(dtype).itemsize, 1)), dtype=dtype, count=size).reshape(shape)


@cache
def _trim() -> Callable[[int], int] | None:
    try:
        trim: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
        return trim
    except (AttributeError, OSError, TypeError):
        return None
