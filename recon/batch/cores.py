"""How the cores of a machine are shared out among sessions."""

import os
import socket

# What the linear algebra under NumPy, SciPy and OpenCV reads when it is loaded.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def usable_cores() -> int:
    """Return the cores that this process may run on: a cluster's queue often grants a part of the machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def place() -> str:
    """Return the host and those of its cores that this process may use: processes of one place share them."""
    own = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    return f"{socket.gethostname()} {own}"


def shared_out(*, cores: int, sessions: int, jobs: int) -> tuple[int, int]:
    """Return how many sessions run at a time and the threads of each; ``jobs`` = 0 chooses.

    Examples
    --------
    >>> shared_out(cores=8, sessions=20, jobs=0), shared_out(cores=8, sessions=2, jobs=0)
    ((8, 1), (2, 4))
    >>> shared_out(cores=8, sessions=20, jobs=3)
    (3, 2)
    """
    at_a_time = max(min(jobs or cores, sessions), 1)
    return at_a_time, max(cores // at_a_time, 1)
