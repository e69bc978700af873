"""The ``recon`` command: each subcommand parses, calls one function and prints one result."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from recon.batch import command as batch_command
from recon.bench.command import register as register_bench
from recon.command_group import CommandGroup, Interrupted
from recon.errors import ReconError, sentence
from recon.evaluation import command as evaluation_command
from recon.metrics import Metrics, StageTime
from recon.progress import progress_bar
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
from recon.study.command import register as register_study
from recon.view import register as register_view

app = typer.Typer(
    cls=CommandGroup,
    help="Turn saved sessions of a transparent object into points, normals and a mesh.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

SessionFolder = Annotated[Path, typer.Argument(metavar="SESSION", help="Folder of a session.")]


@app.command()
def run(
    session: SessionFolder,
    out: Annotated[Path | None, typer.Option(help="Folder for the results. [default: SESSION/recon-METHOD]")] = None,
    method: MethodOption = "full",
    smallest_angle_deg: SmallestAngle = 1.0,
    largest_gap_share: LargestGapShare = DEFAULT.largest_gap_share,
    gap_sigma: GapSigma = DEFAULT.gap_sigma,
    angle_sigma: AngleSigma = DEFAULT.angle_sigma,
    threads: Annotated[
        int, typer.Option(min=0, help="Threads for decoding; 0 takes every core that memory allows.")
    ] = 0,
    calibration: CalibrationFile = None,
    registration: RegistrationSwitch = True,
    board: BoardSwitch = True,
    integration: IntegrationOption = None,
    force: ForceSwitch = False,
) -> None:
    """Reconstruct one session: maps, cloud, mesh, numbers and a report."""
    # Loads the report's plotting, which would slow every other command by a second.
    from recon.run import run_session

    limits = limits_of(
        smallest_angle_deg=smallest_angle_deg,
        largest_gap_share=largest_gap_share,
        gap_sigma=gap_sigma,
        angle_sigma=angle_sigma,
    )
    out = out or session / f"recon-{method}"
    settings = Settings(
        method=method,
        limits=limits,
        threads=threads,
        calibration=calibration,
        registration=registration,
        board=board,
        integration=integration,
        force=force,
    )
    metrics = run_session(session, out, settings, on_stage=print_stage)
    print_result(metrics, out)


def print_stage(stage: StageTime) -> None:
    """Print how a stage went: kept from an earlier run, or done."""
    detail = f" ({stage.detail})" if stage.detail else ""
    print(f"  {stage.name}: {'kept' if stage.kept else f'done in {stage.wall_s:.3g} s'}{detail}", flush=True)


def print_result(metrics: Metrics, out: Path) -> None:
    """Print the verdict, the funnel and where the files are."""
    funnel = metrics.funnel
    print(f"{metrics.verdict.grade.upper()}: {' '.join(metrics.verdict.reasons)}")
    print(f"  next: {metrics.verdict.next_action}")
    print(
        f"  {funnel.pixels} pixels, {funnel.lit} lit, {funnel.matched} matched in all sets, "
        f"{funnel.entry_points} entry points, {funnel.normals} normals"
    )
    unit = metrics.length_unit
    for one in metrics.statistics:
        shown = one.unit if one.unit != "mm" else unit
        print(f"  {one.name}: median {one.median:.4g}, rms {one.rms:.4g}, 95 % below {one.p95:.4g} {shown}")
    for line in metrics.board.sentences if metrics.board else ():
        print(f"  {line}")
    for warning in metrics.warnings:
        print(f"  note: {warning}")
    if metrics.doubtful_ranges:
        print(f"  worth a sweep: {sweep_text(metrics)}; doubtful_ranges in metrics.json tells them set by set")
    print(f"  report: {out / 'report.html'}")


def sweep_text(metrics: Metrics) -> str:
    """Return the columns and rows of the display where a code left readings in doubt."""
    parts = []
    for axis, noun in (("x", "columns"), ("y", "rows")):
        ranges = [one for one in metrics.doubtful_ranges if one.axis == axis]
        if ranges:
            first, last = min(one.first_px for one in ranges), max(one.last_px for one in ranges)
            parts.append(f"{noun} {first} to {last} ({sum(one.pixels for one in ranges)} readings in doubt)")
    return " and ".join(parts)


@app.command("import")
def import_(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of photos.")],
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="Folder to make; absent or empty.")],
    layout: Annotated[Path, typer.Option(help="TOML file that describes geometry, pattern and file names.")],
) -> None:
    """Make a session from a folder of photos that someone else took; no photo is re-encoded."""
    from recon.sessions.importer import import_folder, read_layout

    described = read_layout(layout)
    total = sum(sweep.pattern.count for one in described.manifest.sets for sweep in one.sweeps)
    with progress_bar("importing photos", total) as step:
        count = import_folder(folder, session, described, on_photo=lambda _done, _total: step())
    print(f"{session}: {count} photos in 4 sets. Next: recon run {session}")


@app.command()
def validate(session: SessionFolder) -> None:
    """Name every fault of a session with its file and reason; exit 1 if there is one."""
    from recon.sessions.session import open_session
    from recon.sessions.wholeness import faults

    opened = open_session(session)
    found = list(faults(opened))
    for fault in found:
        print(f"{'warning' if fault.is_warning else 'fault'}: {fault}")
    errors = sum(not fault.is_warning for fault in found)
    warnings = len(found) - errors
    if errors:
        print(f"{session}: {errors} faults and {warnings} warnings in {len(opened.photos)} photos")
        raise typer.Exit(1)
    print(f"{session}: sound; {len(opened.photos)} photos, {warnings} warnings")


batch_command.register(app)
evaluation_command.register(app)
register_bench(app)
register_study(app)
register_view(app)


def main() -> None:
    """Run the command; whatever goes wrong reaches the person as one sentence."""
    try:
        app(prog_name="recon")
    except (ReconError, MemoryError, OSError) as error:
        Console(stderr=True, highlight=False, markup=False, soft_wrap=True).print(f"recon: {sentence(error)}")
        sys.exit(1)
    except (Interrupted, KeyboardInterrupt):
        print("recon: stopped; nothing of the session was changed", file=sys.stderr)
        sys.exit(130)
