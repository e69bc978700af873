"""Rows in bands that threads share: what is found in a row depends neither on its band nor on how many threads there are.

And work of different kinds that threads do at the same time.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

# Fewer rows than this are not worth a thread.
FEWEST_ROWS = 16


def over_bands(work: Callable[[slice], None], rows: int, *, threads: int) -> None:
    """Do the work on all rows, a band of them a thread; it may write nothing but results of its own rows.

    Examples
    --------
    >>> import numpy as np
    >>> square = np.zeros(1000)
    >>> def work(band: slice) -> None:
    ...     square[band] = np.arange(1000.0)[band] ** 2
    >>> over_bands(work, 1000, threads=3)
    >>> bool((square == np.arange(1000.0) ** 2).all())
    True
    """
    count = max(min(threads, rows // FEWEST_ROWS), 1)
    edges = [rows * number // count for number in range(count + 1)]
    bands = [slice(low, high) for low, high in pairwise(edges)]
    if count == 1:
        work(bands[0])
        return
    with ThreadPoolExecutor(count) as pool:
        list(pool.map(work, bands))


def side_by_side(*works: Callable[[], Any], threads: int) -> list[Any]:
    """Do works that know nothing of each other, so many of them at a time, and return what each returns.

    Examples
    --------
    >>> side_by_side(lambda: 1, lambda: "two", threads=2)
    [1, 'two']
    """
    with ThreadPoolExecutor(max(min(threads, len(works)), 1)) as pool:
        jobs = [pool.submit(work) for work in works]
    return [job.result() for job in jobs]
