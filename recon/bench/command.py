"""The ``recon bench`` commands: how fast the correspondence stage and a whole run are on this machine, beside decoding alone."""

import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from recon.batch.cores import usable_cores
from recon.bench.bench_result import BenchResult
from recon.bench.run_result import RunBenchResult
from recon.running.options import MethodOption

TABLE_WIDTH = 96


bench_app = typer.Typer(invoke_without_command=True, rich_markup_mode=None)

KeepFolder = Annotated[
    Path | None, typer.Option(help="Folder where the photos stay, for a later run with the same options.")
]
PhotoFolder = Annotated[
    Path | None,
    typer.Option(help="Where the photos are written for a while. [default: the system's temporary folder]"),
]
Columns = Annotated[int, typer.Option(min=64, metavar="COLUMNS", help="Camera columns.")]
Seed = Annotated[int, typer.Option(min=0, help="Start of the random numbers.")]


def register(app: typer.Typer) -> None:
    """Add ``bench`` to the ``recon`` command."""
    app.add_typer(bench_app, name="bench")


@bench_app.callback()
def bench_command(
    context: typer.Context,
    photos: Annotated[int, typer.Option(min=32, help="Photos of the sweep. The paper: several hundred.")] = 60,
    size: Columns = 3888,
    seed: Seed = 0,
    full: Annotated[bool, typer.Option(help="Measure the full method as well; its fit takes most of the time.")] = True,
    photo_mb: Annotated[
        list[float] | None,
        typer.Option(
            min=0.1,
            help="Size of a photo of 3888 × 2592 pixels, others in proportion; may be repeated. [default: 1, 1.7 and 4]",
        ),
    ] = None,
    keep: KeepFolder = None,
    folder: PhotoFolder = None,
) -> None:
    """Measure time and memory of decoding a sweep, beside decoding alone and naive scripts.

    Makes its own noisy photos. Prints JSON; progress and a table go to the error output. `recon bench run` measures a whole run.
    """
    if context.invoked_subcommand is not None:
        return
    # Loads the decoder, which would slow every other command.
    from recon.bench.benchmark import PAPER_PHOTO_MB, benchmark

    console = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    command = (
        f"recon bench --photos {photos} --size {size}"
        + "".join(f" --photo-mb {one:g}" for one in photo_mb or ())
        + (f" --seed {seed}" if seed else "")
        + ("" if full else " --no-full")
    )
    with ExitStack() as stack:
        result = benchmark(
            keep or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="recon-bench-", dir=folder))),
            columns=size,
            photos=photos,
            photo_mb=tuple(photo_mb or PAPER_PHOTO_MB),
            seed=seed,
            full=full,
            command=command,
            say=lambda text: console.print(f"  {text}"),
        )
    # Both sizes, or rich takes 80 columns wherever the error output is not a terminal.
    Console(stderr=True, width=TABLE_WIDTH, height=1, highlight=False).print(table_of(result))
    for ratio in result.ratios:
        if "one more" in ratio.contestant:
            console.print(
                f"{ratio.contestant}: {ratio.wall:.2f} of {ratio.over} by the wall, {ratio.processor:.2f} by CPU"
            )
    for found in result.agreement:
        console.print(f"{found.contestant}: the same photo as our sweep's in {found.share:.2%} of its pixels")
    typer.echo(result.model_dump_json(indent=1))


@bench_app.command("run")
def run_command(
    photos: Annotated[int, typer.Option(min=32, help="Photos of each of the eight sweeps. The paper: up to 350.")] = 60,
    size: Columns = 1296,
    object_mpx: Annotated[
        float, typer.Option(min=0.001, help="Megapixels of the photo that the object covers; all else is dark.")
    ] = 0.1,
    photo_mb: Annotated[
        float, typer.Option(min=0.1, help="Size of a photo of 3888 × 2592 pixels, others in proportion.")
    ] = 1.7,
    method: MethodOption = "full",
    threads: Annotated[int, typer.Option(min=0, help="Threads for both; 0 takes every core.")] = 0,
    seed: Seed = 0,
    keep: KeepFolder = None,
    folder: PhotoFolder = None,
) -> None:
    """Measure a whole run, stage by stage, beside decoding the session's photos alone.

    Makes its own session of four sets. Prints JSON; progress and a table go to the error output.
    """
    from recon.bench.run_benchmark import run_benchmark

    console = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    threads = threads or usable_cores()
    with ExitStack() as stack:
        result = run_benchmark(
            keep or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="recon-bench-", dir=folder))),
            columns=size,
            photos=photos,
            object_megapixels=object_mpx,
            photo_mb=photo_mb,
            method=method,
            threads=threads,
            seed=seed,
            command=(
                f"recon bench run --photos {photos} --size {size} --object-mpx {object_mpx:g} --photo-mb {photo_mb:g}"
                + ("" if method == "full" else f" --method {method}")
                + f" --threads {threads}"
                + (f" --seed {seed}" if seed else "")
            ),
            say=lambda text: console.print(f"  {text}"),
        )
    Console(stderr=True, width=TABLE_WIDTH, height=1, highlight=False).print(run_table(result))
    console.print(
        f"the run took {result.over_decoding_wall:.2f} times decoding alone by the wall, "
        f"{result.over_decoding_processor:.2f} by CPU; {result.surface.share:.1%} of the object found, "
        f"{result.surface.error_rms_mm:.2g} mm RMS from its surface"
    )
    typer.echo(result.model_dump_json(indent=1))


def run_table(result: RunBenchResult) -> Table:
    """Return decoding alone, the whole run, and its stages."""
    machine = result.machine
    shown = Table(
        title=result.command,
        caption=(
            f"{result.photos.photos} photos of {1e3 * result.photos.file_mb:.0f} kB; {machine.processor}, {machine.cores} cores; "
            f"load {machine.load_before:.1f} before, {machine.load_after:.1f} after. The peak is the process's so far"
        ),
        box=SIMPLE,
        padding=(0, 1, 0, 0),
    )
    for heading in ("", "wall s", "CPU s", "peak MB"):
        shown.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for one in (result.decoding, result.run, *result.stages):
        name = one.name if one in (result.decoding, result.run) else f"  {one.name}"
        shown.add_row(name, f"{one.wall_s:.3g}", f"{one.processor_s:.3g}", f"{one.peak_mb:.0f}")
    return shown


def table_of(result: BenchResult) -> Table:
    """Return the measurements in the order in which they were made, with their ratios."""
    machine = result.machine
    shown = Table(
        title=result.command,
        caption=(
            f"{machine.processor}, {machine.cores} cores; load {machine.load_before:.1f} before, "
            f"{machine.load_after:.1f} after. × is over decoding alone; of the argmax scripts, over our sweep"
        ),
        box=SIMPLE,
        padding=(0, 1, 0, 0),
    )
    headings = ("contestant", "photos", "kB", "threads", "wall s", "CPU s", "Mpx/s", "peak MB", "×wall", "×CPU")
    for heading in headings:
        shown.add_column(heading, justify="left" if heading == "contestant" else "right", no_wrap=True)
    ratio_of = {(one.contestant, one.file_mb, one.threads): one for one in result.ratios}
    for one in result.measurements:
        ratio = ratio_of.get((one.contestant, one.file_mb, one.threads))
        shown.add_row(
            one.contestant,
            str(one.photos),
            f"{1e3 * one.file_mb:.0f}",
            str(one.threads),
            f"{one.wall_s:.3g}",
            f"{one.processor_s:.3g}",
            f"{one.megapixels_per_s:.3g}",
            f"{one.peak_mb:.0f}",
            f"{ratio.wall:.2f}" if ratio else "",
            f"{ratio.processor:.2f}" if ratio else "",
        )
    return shown
