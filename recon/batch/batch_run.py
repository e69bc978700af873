"""The loop of a batch: hand out the sessions, take in what became of each, and make an orderly end of an interruption.

It is the same for every executor (PEP 3148). How far a session is, is told by its ``status.json`` alone: an answer that never
comes, because its worker is gone, leaves the truth there.
"""

import contextlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field, replace

from recon.batch.batch_record import Batch
from recon.batch.one_session import STOP_NAME, SessionTask, run_one
from recon.batch.session_status import MOST_ATTEMPTS, SessionStatus, save_status
from recon.batch.stop_signal import StopSignal
from recon.errors import ReconError
from recon.program import program_hash

POLL_S = 0.2
Pending = dict[Future[SessionStatus], SessionTask]


@dataclass(frozen=True, slots=True)
class Crew:
    """Who works, called ``name``: an executor, and the error by which it says that a worker is gone.

    A session takes ``threads`` threads; 0 lets each worker share the cores of its place with the others of ``workers_at``.
    ``kill`` ends all that runs, where that can be done.
    """

    name: str
    executor: Executor
    lost: type[Exception]
    threads: int = 0
    workers_at: Mapping[str, int] = field(default_factory=dict)
    kill: Callable[[], None] | None = None


def run_batch(
    batch: Batch,
    names: Sequence[str],
    *,
    crew: Crew,
    stop: StopSignal,
    on_change: Callable[[str, SessionStatus], None],
    on_stop: Callable[[int], None],
) -> dict[str, SessionStatus]:
    """Run the sessions ``names`` and return what became of each.

    ``on_change`` hears of each session that came to an end or lost its worker. Once ``stop`` asks, nothing new is begun and
    what runs is waited for (``on_stop`` hears how many); once it asks again, what runs is ended where the crew can.
    """
    marker = batch.folder / STOP_NAME
    marker.unlink(missing_ok=True)
    tasks = {name: _task(batch, name, crew) for name in names}
    found = {name: task.waiting for name, task in tasks.items()}
    for name, status in found.items():
        save_status(status, batch.folder / name)
    losses: Counter[str] = Counter()
    pending: Pending = {}
    handled = 0
    try:
        pending.update((crew.executor.submit(run_one, task), task) for task in tasks.values())
        while pending:
            ended, _ = wait(pending, timeout=POLL_S, return_when=FIRST_COMPLETED)
            for future in ended:
                task = pending.pop(future)
                found[task.name] = status = _taken_in(future, task, batch, crew, losses=losses, stop=stop)
                if status.state != "waiting" or losses[task.name]:
                    on_change(task.name, status)
                if status.state == "waiting" and not stop.asked:
                    pending[crew.executor.submit(run_one, task)] = task
            if handled == 0 and stop.asked:
                handled = 1
                marker.write_bytes(b"")
                _call_off(pending, batch)
                on_stop(len(pending))
            if handled == 1 and stop.asked > 1:
                handled = 2
                if crew.kill is None:
                    break
                crew.kill()
    finally:
        marker.unlink(missing_ok=True)
        for task in pending.values():
            found[task.name] = batch.status_of(task.name)
    return found


def _task(batch: Batch, name: str, crew: Crew) -> SessionTask:
    return SessionTask(
        name=name,
        session=batch.sessions[name],
        batch_folder=batch.folder,
        settings=replace(batch.settings, threads=crew.threads),
        waiting=batch.waiting(name),
        program=program_hash(),
        workers_at=dict(crew.workers_at),
    )


def _call_off(pending: Pending, batch: Batch) -> None:
    """Take back what no worker has begun. The status decides: some executors would let go of running calls as well."""
    for future, task in list(pending.items()):
        if batch.status_of(task.name).state == "waiting" and future.cancel():
            del pending[future]


def _taken_in(
    future: Future[SessionStatus],
    task: SessionTask,
    batch: Batch,
    crew: Crew,
    *,
    losses: Counter[str],
    stop: StopSignal,
) -> SessionStatus:
    """Return what became of a session; where its worker is gone or could not say, write it down in its place."""
    try:
        return future.result()
    except CancelledError:
        raise ReconError(
            "the workers' scheduler is gone; what is done is kept, and `recon batch --resume` goes on with the rest"
        ) from None
    except crew.lost as error:
        status = batch.status_of(task.name)
        if status.state not in ("waiting", "running"):
            return status
        if stop.asked > 1:
            status = status.ended("stopped") if status.state == "running" else status
        else:
            losses[task.name] += 1
            if status.state == "running":
                status = status.lost(str(error))
            elif losses[task.name] >= MOST_ATTEMPTS:
                status = status.ended("failed", fault=f"its worker was lost before it began ({error})")
    except Exception as error:  # a worker without recon, a disk that is full: that session's fault, not the others'
        text = f"its worker could not run it ({type(error).__name__}: {error})"
        status = batch.status_of(task.name).ended("failed", fault=text)
    with contextlib.suppress(OSError):  # the answer of this call is what counts here
        save_status(status, task.out)
    return status
