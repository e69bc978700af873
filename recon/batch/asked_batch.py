"""A batch from what was asked for to the group's files: which sessions, on which workers, and how it went in words."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from recon.batch.batch_record import Batch, recorded_sessions, save_record
from recon.batch.batch_run import Crew, run_batch
from recon.batch.batch_talk import BatchTalk
from recon.batch.cluster import cluster_crew
from recon.batch.cores import shared_out, usable_cores
from recon.batch.group_files import write_group_files
from recon.batch.own_processes import OwnProcesses, WorkerLostError
from recon.batch.session_list import sessions_asked
from recon.batch.session_status import SessionStatus
from recon.batch.stop_signal import StopSignal
from recon.errors import ReconError
from recon.running.settings import Settings


def run_asked(
    sessions: Sequence[str] | None,
    out: Path,
    settings: Settings,
    *,
    jobs: int,
    scheduler: str | None,
    resume: bool,
    only_failed: bool,
) -> bool:
    """Reconstruct the sessions, or those of the batch in ``out`` without any; tell whether the person stopped it.

    Raises ``ReconError`` where a session failed, when all others are done.
    """
    named = sessions_asked(sessions) if sessions else recorded_sessions(out)
    batch = Batch(out.resolve(), named, settings)
    save_record(batch)
    names = chosen(batch, resume=resume, only_failed=only_failed)
    talk = BatchTalk(batch, len(names))
    stop = StopSignal()
    found: dict[str, SessionStatus] = {}
    try:
        if names:
            crew = (
                cluster_crew(scheduler, threads=settings.threads)
                if scheduler
                else local_crew(len(names), jobs=jobs, threads=settings.threads)
            )
            with stop, crew as ready, talk:
                talk.begin(ready)
                found = run_batch(batch, names, crew=ready, stop=stop, on_change=talk.tell, on_stop=talk.stopping)
    finally:
        statuses = {name: batch.status_of(name) for name in batch.sessions} | found
        rows = write_group_files(batch, statuses)
    talk.summary(rows)
    if stop.asked:
        talk.interrupted(statuses)
        return True
    failed = [name for name, status in statuses.items() if status.state != "done"]
    if failed:
        raise ReconError(talk.failure(failed))
    return False


def chosen(batch: Batch, *, resume: bool, only_failed: bool) -> list[str]:
    """Return the sessions to run."""
    if only_failed:
        return [name for name in batch.sessions if batch.has_failed(name)]
    if resume:
        return [name for name in batch.sessions if not (batch.is_done(name) or batch.has_failed(name))]
    return list(batch.sessions)


@contextmanager
def local_crew(sessions: int, *, jobs: int, threads: int) -> Iterator[Crew]:
    """Give the processes of this machine: as many at a time, with as many threads each, as there are cores."""
    at_a_time, share = shared_out(cores=usable_cores(), sessions=sessions, jobs=jobs)
    with OwnProcesses(at_a_time, threads=threads or share, preload=("recon.run",)) as executor:
        yield Crew(
            f"{at_a_time} processes of this machine, {threads or share} threads each",
            executor,
            WorkerLostError,
            threads=threads or share,
            kill=executor.kill,
        )
