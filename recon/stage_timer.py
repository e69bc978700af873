"""Time and peak memory of each stage of a run."""

import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from recon.metrics import StageTime


def peak_memory_mb() -> float:
    """Return the largest resident size of this process so far, in MB (getrusage(2): kB on Linux, bytes on macOS)."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1e6 if sys.platform == "darwin" else 1e3)


class StageTimer:
    """Collects one :class:`~recon.metrics.StageTime` a stage, in order."""

    def __init__(self) -> None:
        self._stages: list[StageTime] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what runs inside; the memory is the process's peak at the stage's end."""
        start = time.perf_counter()
        yield
        self._stages.append(StageTime(name=name, wall_s=time.perf_counter() - start, peak_mb=peak_memory_mb()))

    def stages(self) -> tuple[StageTime, ...]:
        """Return the finished stages."""
        return tuple(self._stages)
