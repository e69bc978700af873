"""What the machine is, and how busy it is."""

import os
import platform
from pathlib import Path

from recon.batch.cores import usable_cores
from recon.bench.bench_result import Machine


def machine() -> Machine:
    """Return the machine with its load now; ``load_after`` is for whoever measures to set."""
    load = os.getloadavg()[0]
    return Machine(
        processor=_processor(),
        cores=usable_cores(),
        memory_gb=round(memory_bytes() / 1e9, 1),
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        load_before=load,
        load_after=load,
    )


def memory_bytes() -> int:
    """Return the machine's memory."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _processor() -> str:
    """Return the processor's name: Linux keeps it in a file, other systems tell Python."""
    file = Path("/proc/cpuinfo")
    if file.is_file():
        for line in file.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
