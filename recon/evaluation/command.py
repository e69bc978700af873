"""The ``recon evaluate`` command: parse, evaluate, print one table a run."""

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from recon.errors import ReconError
from recon.evaluation.published import MOST_FACETS, THRESHOLD_MM, Primitive
from recon.maps import MAPS_NAME


def register(app: typer.Typer) -> None:
    """Add ``evaluate`` to the ``recon`` command."""
    app.command("evaluate")(evaluate_command)


def evaluate_command(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="Results of `recon run`, or a session with results.")],
    primitive: Annotated[Primitive | None, typer.Option(help="Shape to fit to the points.")] = None,
    truth: Annotated[
        Path | None, typer.Option(help="Truth file, or a simulated session. [default: that of the run's session]")
    ] = None,
    ellipsoid: Annotated[
        str | None, typer.Option(metavar="A,B,C", help="Semi-axes of a known ellipsoid about the origin, in mm.")
    ] = None,
    ring: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="FROM TO", help="Truth: judge only these distances from the z axis, in mm."),
    ] = None,
    known_radius: Annotated[
        float | None, typer.Option(min=0.0, help="The object's radius by other means, in mm.")
    ] = None,
    known_height: Annotated[
        float | None, typer.Option(min=0.0, help="The object's height by other means, in mm.")
    ] = None,
    facets: Annotated[int, typer.Option(min=1, help="Planes: how many facets to look for.")] = MOST_FACETS,
    threshold: Annotated[
        float, typer.Option(min=1e-9, help="Planes and cylinder: largest distance of an inlier, in mm.")
    ] = THRESHOLD_MM,
    seed: Annotated[int, typer.Option(min=0, help="Start of the fits' random draws.")] = 0,
) -> None:
    """Compare results with truth or with a fitted shape, beside the published figures; writes evaluation.json."""
    # Fits and the report's plotting, which would slow every other command by a second.
    from recon.evaluation.evaluate import EVALUATION_NAME, evaluate, save_evaluation
    from recon.evaluation.shown_figures import evaluation_table, report_row
    from recon.evaluation.table import KnownSize
    from recon.report.rewrite import rewrite_report

    console = Console(markup=False, highlight=False)
    for run_folder in run_folders(folder):
        result = evaluate(
            run_folder,
            primitive=primitive,
            truth=truth,
            ellipsoid_mm=None if ellipsoid is None else semi_axes_mm(ellipsoid),
            known=KnownSize(known_radius or None, known_height or None),
            ring_mm=ring,
            most_facets=facets,
            threshold_mm=threshold,
            seed=seed,
        )
        save_evaluation(result, run_folder / EVALUATION_NAME)
        console.print(evaluation_table(result))
        if rewrite_report(run_folder, [report_row(row, result.length_unit) for row in result.rows]) is not None:
            console.print(f"The report shows them too: {run_folder / 'report.html'}", soft_wrap=True)


def run_folders(folder: Path) -> list[Path]:
    """Return the folder itself if it holds results, else the result folders directly inside it."""
    if (folder / MAPS_NAME).exists() or not folder.is_dir():
        return [folder]
    inside = sorted(path.parent for path in folder.glob(f"*/{MAPS_NAME}"))
    return inside or [folder]


def semi_axes_mm(text: str) -> tuple[float, float, float]:
    """Parse three positive numbers with commas between them.

    Examples
    --------
    >>> semi_axes_mm("12.5, 12.5, 5")
    (12.5, 12.5, 5.0)
    """
    try:
        a, b, c = (float(part) for part in text.split(","))
    except ValueError:
        raise ReconError(
            f"--ellipsoid {text}: three numbers with commas between them wanted, like 12.5,12.5,5"
        ) from None
    if not all(math.isfinite(axis) and axis > 0 for axis in (a, b, c)):
        raise ReconError(f"--ellipsoid {text}: the semi-axes must be positive")
    return a, b, c
