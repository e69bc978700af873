"""The ``recon batch`` command: parse, run the batch, print how it went."""

from pathlib import Path
from typing import Annotated, Literal

import typer

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
    # Workers, clusters and the group page's plotting, which would slow every other command by a second.
    from recon.batch.asked_batch import run_asked

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
    if run_asked(sessions, out, settings, jobs=jobs, scheduler=scheduler, resume=resume, only_failed=only == "failed"):
        raise typer.Exit(INTERRUPTED)
