"""Memory that is free inside the process, and how the system gets it back."""

import ctypes
from collections.abc import Callable
from functools import cache


def give_back_free_memory() -> None:
    """Return what the allocator holds free to the system.

    The GNU C library keeps arrays of up to 32 MB for itself once such arrays have been freed, in pieces between others, so that
    a process grows by as much again as it uses. Where it has no ``malloc_trim`` (other C libraries), nothing is done.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Callable[[int], int] | None:
    try:
        trim: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
        return trim
    except (AttributeError, OSError, TypeError):
        return None
