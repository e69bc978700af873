"""An executor that gives every call a process of its own, so that one that is killed takes nothing with it and is known.

``concurrent.futures.ProcessPoolExecutor`` fails every pending call when any worker dies, and does not say whose it was. A fresh
process also makes a session's peak memory its own.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from recon.batch.cores import THREAD_VARIABLES


class WorkerLostError(Exception):
    """A process ended without an answer; the message says how."""


class OwnProcesses(Executor):
    """Runs at most ``jobs`` calls at once, each in a new process whose libraries take ``threads`` threads.

    ``preload`` names modules that every process has loaded when it starts.
    """

    def __init__(self, jobs: int, *, threads: int, preload: Sequence[str] = ()) -> None:
        # A fork of this very process would copy its threads' locks; the server is forked instead, which has none.
        known = "forkserver" in multiprocessing.get_all_start_methods()
        self._context = multiprocessing.get_context("forkserver") if known else multiprocessing.get_context("spawn")
        self._context.set_forkserver_preload(list(preload))
        # A folder in which somebody happens to work must not stand for a library of the same name.
        self._variables = {**dict.fromkeys(THREAD_VARIABLES, str(threads)), "PYTHONSAFEPATH": "1"}
        self._lanes = ThreadPoolExecutor(jobs, thread_name_prefix="batch")
        self._running: set[BaseProcess] = set()
        self._starting = threading.Lock()
        self._killed = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run ``fn(*args, **kwargs)`` in a process when there is room; the future raises ``WorkerLostError`` if that dies."""
        return self._lanes.submit(self._call, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more calls, and wait for those that run."""
        self._lanes.shutdown(wait, cancel_futures=cancel_futures)

    def kill(self) -> None:
        """End every running call now; what waits ends as lost as well."""
        with self._starting:
            self._killed = True
            for process in self._running:
                process.terminate()

    def _call(self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        receiver, sender = self._context.Pipe(duplex=False)
        process = self._context.Process(target=_answer, args=(sender, fn, args, kwargs), daemon=True)
        with self._starting, _environment(self._variables):
            if self._killed:
                raise WorkerLostError("not begun")
            process.start()
            self._running.add(process)
        sender.close()
        try:
            with receiver:
                failed, answer = receiver.recv()
        except EOFError:  # the other end was closed by the process's death
            process.join()
            raise WorkerLostError(_how_it_ended(process.exitcode)) from None
        finally:
            process.join()
            with self._starting:
                self._running.discard(process)
        if failed:
            raise answer
        return answer


def _how_it_ended(exit_code: int | None) -> str:
    """Say in a few words how a process ended; the kernel kills with SIGKILL what takes the last of the memory."""
    if exit_code is None or exit_code >= 0:
        return f"it ended with status {exit_code}"
    name = signal.Signals(-exit_code).name
    return f"killed by {name}" + (", as the system does when memory runs out" if name == "SIGKILL" else "")


def _answer(sender: Connection, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
    """Call in the new process and send what comes of it."""
    # A terminal's Ctrl-C reaches every process of its group; who coordinates them decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        answer = (False, fn(*args, **kwargs))
    except Exception as error:
        answer = (True, error)
    sender.send(answer)


def _end_with_parent() -> None:
    """End this process when the one that waits for its answer is gone."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Set variables of the environment that are not set, and take them back."""
    fresh = {name: value for name, value in values.items() if name not in os.environ}
    os.environ.update(fresh)
    try:
        yield
    finally:
        for name in fresh:
            del os.environ[name]
