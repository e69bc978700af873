"""Loops over pixels, compiled to machine code by Numba, for what vector operations would do in many passes over memory."""

from collections.abc import Callable
from inspect import unwrap
from typing import ParamSpec, TypeVar

from numba import njit

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def compiled(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile a function of arrays and numbers when it is first called, and keep the machine code for the next process.

    It runs without the interpreter's lock, so that threads share the cores, and checks no index: shapes are checked by what
    calls it. Sums keep their order, so that code just compiled and code that was kept give the same bytes. Where no folder can be
    written, it is compiled once a process.
    """
    plain = unwrap(function)
    options = {"nogil": True, "error_model": "numpy"}
    try:
        kept: Callable[Arguments, Result] = njit(plain, cache=True, **options)
    except RuntimeError:  # Numba's own word for that there is no such folder
        kept = njit(plain, **options)
    return kept
