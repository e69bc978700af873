"""Time and peak memory of each stage of a run."""

import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from recon.metrics import StageTime


def peak_memory_mb() -> float:
    """Return the largest resident size of this process so far, in 10⁶ bytes.

    On Linux that is VmHWM of proc(5), in KiB: getrusage(2) keeps what the program had that started this one. Elsewhere it has to
    serve; macOS counts in bytes.
    """
    try:
        told = Path("/proc/self/status").read_text(encoding="utf-8")
        return int(told.split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    except (OSError, IndexError):
        size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return size * (1 if sys.platform == "darwin" else 1024) / 1e6


@dataclass(slots=True)
class Stage:
    """What a stage has to say of itself: whether all of it was kept from an earlier run, or what part."""

    kept: bool = False
    detail: str = ""


class StageTimer:
    """Collects one :class:`~recon.metrics.StageTime` a stage, in order; ``on_stage`` hears of each as it ends."""

    def __init__(self, on_stage: Callable[[StageTime], None] = lambda _: None) -> None:
        self._stages: list[StageTime] = []
        self._on_stage = on_stage

    @contextmanager
    def stage(self, name: str) -> Iterator[Stage]:
        """Time what runs inside; the memory is the process's peak at the stage's end."""
        start = time.perf_counter()
        stage = Stage()
        yield stage
        took_s = time.perf_counter() - start
        self._stages.append(
            StageTime(name=name, wall_s=took_s, peak_mb=peak_memory_mb(), kept=stage.kept, detail=stage.detail)
        )
        self._on_stage(self._stages[-1])

    def stages(self) -> tuple[StageTime, ...]:
        """Return the finished stages."""
        return tuple(self._stages)
