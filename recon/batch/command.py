"""The ``recon batch`` command: parse, run the batch, print how it went."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import typer

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
from recon.running.options import (
    DEFAULT,
    AngleSigma,
    BoardSwitch,
    CalibrationFile,
    ForceSwitch,
    GapSigma,
    IntegrationOption,
    LargestGapShare,
    MethodOption,
    RegistrationSwitch,
    SmallestAngle,
    limits_of,
)
from recon.running.settings import Settings

INTERRUPTED = 130


def register(app: typer.Typer) -> None:
    """Add ``batch`` to the ``recon`` command."""
    app.command("batch")(batch_command)


def batch_command(
    sessions: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SESSION",
            help="Folders of sessions, patterns in quotes, or text files with one folder a line. "
            "[default: those of the batch in --out]",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results, one folder a session.")] = Path("recon-batch"),
    method: MethodOption = "full",
    smallest_angle_deg: SmallestAngle = 1.0,
    largest_gap_share: LargestGapShare = DEFAULT.largest_gap_share,
    gap_sigma: GapSigma = DEFAULT.gap_sigma,
    angle_sigma: AngleSigma = DEFAULT.angle_sigma,
    calibration: CalibrationFile = None,
    registration: RegistrationSwitch = True,
    board: BoardSwitch = True,
    integration: IntegrationOption = None,
    jobs: Annotated[
        int, typer.Option(min=0, help="Sessions at a time on this machine; 0 takes as many as there are cores.")
    ] = 0,
    threads: Annotated[int, typer.Option(min=0, help="Threads of each session; 0 shares the cores out.")] = 0,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on the Dask cluster of this scheduler, such as tcp://node1:8786."),
    ] = None,
    force: ForceSwitch = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Leave out what is done, or failed, with these settings.")
    ] = False,
    only: Annotated[Literal["failed"] | None, typer.Option(help="Run only what failed with these settings.")] = None,
) -> None:
    """Reconstruct many sessions at a time; one that is bad never stops the others."""
    if scheduler and jobs:
        raise ReconError("--jobs is for this machine; on a cluster its workers are the number of sessions at a time")
    named = sessions_asked(sessions) if sessions else recorded_sessions(out)
    limits = limits_of(
        smallest_angle_deg=smallest_angle_deg,
        largest_gap_share=largest_gap_share,
        gap_sigma=gap_sigma,
        angle_sigma=angle_sigma,
    )
    settings = Settings(
        method=method,
        limits=limits,
        threads=threads,
        calibration=calibration and calibration.resolve(),
        registration=registration,
        board=board,
        integration=integration,
        force=force,
    )
    batch = Batch(out.resolve(), named, settings)
    save_record(batch)
    names = chosen(batch, resume=resume, only_failed=only == "failed")
    talk = BatchTalk(batch, len(names))
    stop = StopSignal()
    found: dict[str, SessionStatus] = {}
    try:
        if names:
            crew = (
                cluster_crew(scheduler, threads=threads)
                if scheduler
                else local_crew(len(names), jobs=jobs, threads=threads)
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
        raise typer.Exit(INTERRUPTED)
    failed = [name for name, status in statuses.items() if status.state != "done"]
    if failed:
        raise ReconError(talk.failure(failed))


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
