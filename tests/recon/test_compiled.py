"""Compiled loops: numbers of closed forms, and no need of a folder to keep the machine code in."""

from typing import Any

import numpy as np

from recon.compiled import compiled

SUM_OF_SQUARES = """
def sum_of_squares(values):
    total = 0.0
    for value in values:
        total += value * value
    return total
"""


def test_a_function_without_a_file_to_keep_its_code_beside_is_compiled_all_the_same() -> None:
    names: dict[str, Any] = {}
    exec(compile(SUM_OF_SQUARES, "<no file>", "exec"), names)
    sum_of_squares = compiled(names["sum_of_squares"])
    # n (n + 1) (2 n + 1) / 6
    assert sum_of_squares(np.arange(101.0)) == 338350.0
    assert np.isnan(sum_of_squares(np.array([1.0, np.nan])))
