"""The ``recon bench`` command: how fast the correspondence stage is on this machine, beside decoding and naive scripts."""

import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from recon.bench.bench_result import BenchResult

TABLE_WIDTH = 96


def register(app: typer.Typer) -> None:
    """Add ``bench`` to the ``recon`` command."""
    app.command("bench")(bench_command)


def bench_command(
    photos: Annotated[int, typer.Option(min=32, help="Photos of the sweep. The paper: several hundred.")] = 60,
    size: Annotated[int, typer.Option(min=64, metavar="COLUMNS", help="Camera columns.")] = 3888,
    seed: Annotated[int, typer.Option(min=0, help="Start of the random numbers.")] = 0,
    full: Annotated[bool, typer.Option(help="Measure the full method as well; its fit takes most of the time.")] = True,
    photo_mb: Annotated[
        list[float] | None,
        typer.Option(
            min=0.1,
            help="Size of a photo of 3888 × 2592 pixels, others in proportion; may be repeated. [default: 1, 1.7 and 4]",
        ),
    ] = None,
    keep: Annotated[
        Path | None, typer.Option(help="Folder where the photos stay, for a later run with the same options.")
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(help="Where the photos are written for a while. [default: the system's temporary folder]"),
    ] = None,
) -> None:
    """Measure time and memory of decoding a sweep, beside decoding alone and naive scripts.

    Makes its own noisy photos. Prints JSON; progress and a table go to the error output.
    """
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
