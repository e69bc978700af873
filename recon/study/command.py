"""The ``recon study`` command: repeat the published experiments, one or all."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.table import Table

from recon.bad_value import first_fault
from recon.errors import ReconError
from recon.study.experiment import Experiment, StudySize, named
from recon.study.study_result import StudyResult, StudyTable, cell_text, markdown

ALL = "all"
MARKDOWN_NAME = "study.md"


def register(app: typer.Typer) -> None:
    """Add ``study`` to the ``recon`` command."""
    app.command("study")(study_command)


def study_command(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Which experiment, or `all`; without a name they are listed.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for simulated sessions, results and the page.")] = Path("study"),
    size: Annotated[
        int | None,
        typer.Option(min=16, metavar="COLUMNS", help="Camera columns. The paper: 1024, and 3888 for real objects."),
    ] = None,
    rounds: Annotated[
        int | None, typer.Option(min=1, help="Rounds of noise, where there are any. The paper: 500.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Start of the random numbers.")] = 0,
) -> None:
    """Repeat the published experiments with both methods, beside the published figures.

    Needs the simulator (`rig simulate`). Writes a page, tables and JSON.
    """
    # Every experiment's own libraries, which would slow every other command by a second.
    from recon.study.catalogue import EXPERIMENTS

    console = Console(soft_wrap=True, highlight=False)
    if name is None:
        for one in EXPERIMENTS:
            console.print(f"{one.name:18} {one.title}", markup=False)
        return
    chosen = EXPERIMENTS if name == ALL else (_experiment(name, EXPERIMENTS),)
    for experiment in chosen:
        result = _run(experiment, out, StudySize(size, rounds, seed), console)
        (out / f"{experiment.name}.json").write_text(result.model_dump_json(indent=1) + "\n", encoding="utf-8")
        for table in result.tables:
            show_table(table, console)
        page = write_page(out, EXPERIMENTS)
    console.print(f"{page}: curves and tables; {MARKDOWN_NAME} and JSON beside it", markup=False)


def write_page(out: Path, experiments: Sequence[Experiment]) -> Path:
    """Write the page and its Markdown of every result that the folder holds, and return the page."""
    from recon.study.study_page import PAGE_NAME, page_of

    results = []
    for experiment in experiments:
        file = out / f"{experiment.name}.json"
        if file.is_file():
            try:
                results.append(StudyResult.model_validate_json(file.read_text(encoding="utf-8")))
            except ValidationError as error:
                raise ReconError(
                    f"{file}: not the result of a study ({first_fault(error, whole='file')}); delete it"
                ) from None
    (out / PAGE_NAME).write_text(page_of(results), encoding="utf-8")
    (out / MARKDOWN_NAME).write_text("\n".join(markdown(result) for result in results), encoding="utf-8")
    return out / PAGE_NAME


def _run(experiment: Experiment, out: Path, size: StudySize, console: Console) -> StudyResult:
    console.print(f"{experiment.name}: {experiment.title}", markup=False)
    out.mkdir(parents=True, exist_ok=True)
    begun_s = time.monotonic()
    found = experiment.run(out, size, lambda text: console.print(f"  {text}", markup=False))
    given = {"--size": size.columns, "--rounds": size.rounds, "--seed": size.seed or None}
    words = [f"{option} {value}" for option, value in given.items() if value is not None]
    return StudyResult(
        name=experiment.name,
        title=experiment.title,
        setting=found.setting,
        command=" ".join(["recon study", experiment.name, *words]),
        seconds=time.monotonic() - begun_s,
        tables=found.tables,
        figures=found.figures,
    )


def _experiment(name: str, experiments: Sequence[Experiment]) -> Experiment:
    found = named(experiments, name)
    if found is None:
        known = ", ".join([*(one.name for one in experiments), ALL])
        raise ReconError(f"there is no study named {name!r}; choose one of: {known}")
    return found


def show_table(table: StudyTable, console: Console) -> None:
    """Print a table without breaking words; a terminal that is too narrow for that gets a sentence instead."""
    rows = [[cell_text(value) for value in row] for row in table.rows]
    longest = [
        max(len(word) for text in column for word in [*text.split(), ""])
        for column in zip(table.headings, *rows, strict=True)
    ]
    needed = sum(longest) + 3 * len(longest) + 1  # words are not broken, and borders stand between columns
    if needed > console.width and console.is_terminal:
        words = f"{table.title}: {len(longest)} columns do not fit in this window; the page shows them"
        console.print(words, markup=False, highlight=False)
        return
    shown = Table(title=table.title, caption=table.note or None)
    for heading, width in zip(table.headings, longest, strict=True):
        shown.add_column(heading, min_width=width)
    for texts in rows:
        shown.add_row(*texts)
    wide_enough = console if needed <= console.width else Console(file=console.file, width=needed)
    wide_enough.print(shown)
