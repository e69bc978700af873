"""A Dask cluster on this machine alone: a scheduler and workers as programs of their own, listening on 127.0.0.1."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

LIMIT_S = 120.0
LOCAL = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")


@contextmanager
def local_cluster(folder: Path, *, workers: int) -> Iterator[str]:
    """Give the address of a scheduler that has ``workers`` workers of one thread; their logs are in ``folder``."""
    file = folder / "scheduler.json"
    with ExitStack() as stack:
        stack.enter_context(_program("dask_scheduler", folder, "--port", "0", "--scheduler-file", str(file)))
        for number in range(workers):
            # Without a nanny one that is killed stays away, as where its machine is lost.
            options = ("--no-nanny", "--nthreads", "1", "--memory-limit", "0", "--name", f"worker-{number}")
            files = ("--scheduler-file", str(file), "--local-directory", str(folder / f"scratch-{number}"))
            stack.enter_context(_program("dask_worker", folder, *options, *files, log=f"worker-{number}"))
        address = _address(file)
        _wait_for_workers(address, workers)
        yield address


@contextmanager
def _program(name: str, folder: Path, *options: str, log: str = "") -> Iterator[None]:
    command = [sys.executable, "-m", f"distributed.cli.{name}", *LOCAL, *options]
    with (folder / f"{log or name}.log").open("wb") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)
        try:
            yield
        finally:
            process.terminate()
            process.wait(timeout=LIMIT_S)


def _address(file: Path) -> str:
    deadline_s = time.monotonic() + LIMIT_S
    while not file.exists():
        assert time.monotonic() < deadline_s, f"the scheduler did not start; see {file.parent}"
        time.sleep(0.05)
    return str(json.loads(file.read_text())["address"])


def _wait_for_workers(address: str, workers: int) -> None:
    import distributed

    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(workers, timeout=LIMIT_S)
