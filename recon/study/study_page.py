"""The page of the studies: one section an experiment, its curves and tables, and the command that repeats it."""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from recon.report.page import render_page
from recon.report.panel import Panel, Section, Table
from recon.report.theme_pictures import THEMES, Picture
from recon.study.study_result import StudyFigure, StudyResult, StudyTable, cell_text

PAGE_NAME = "study.html"
WIDTH_IN, HEIGHT_IN, DOTS_PER_IN = 9.0, 3.6, 130


def page_of(results: Sequence[StudyResult]) -> str:
    """Return the page of all results, in their order."""
    return render_page(
        "The published experiments, repeated",
        kind="Study",
        subtitle="Both methods side by side; figures of Han, Wong, Liu (IJCV 2018) where they are given.",
        sections=tuple(_section(result) for result in results),
    )


def _section(result: StudyResult) -> Section:
    curves = tuple(
        Panel(
            f"{result.name}-curve-{number}",
            figure.title,
            "map.html.j2",
            {"picture": curve_picture(figure), "step": 1},
        )
        for number, figure in enumerate(result.figures)
    )
    tables = tuple(
        Panel(
            f"{result.name}-table-{number}",
            table.title,
            "table.html.j2",
            {"table": _table(table)},
            what=table.note,
        )
        for number, table in enumerate(result.tables)
    )
    intro = f"{result.setting} Repeat it with `{result.command}` ({result.seconds:.0f} s here)."
    return Section(result.name, result.title, (*curves, *tables), intro)


def _table(table: StudyTable) -> Table:
    rows = tuple(tuple(cell_text(value) for value in row) for row in table.rows)
    numeric = tuple(
        place for place in range(len(table.headings)) if any(isinstance(row[place], int | float) for row in table.rows)
    )
    return Table(table.headings, rows, numeric)


def curve_picture(figure: StudyFigure) -> Picture:
    """Return the curves of a figure in both themes; the two methods differ in the line's style."""
    light, dark = (_drawn(figure, ink=ink, ground=ground) for ink, ground in THEMES.values())
    words = f"{figure.title}: {figure.y_label} over {figure.x_label}, {len(figure.curves)} curves; numbers in the table below"
    return Picture(light, dark, words, int(WIDTH_IN * DOTS_PER_IN), int(HEIGHT_IN * DOTS_PER_IN))


def _drawn(figure: StudyFigure, *, ink: str, ground: str) -> bytes:
    settings: dict[Any, Any] = {
        "text.color": ink,
        "axes.labelcolor": ink,
        "axes.edgecolor": ink,
        "xtick.color": ink,
        "ytick.color": ink,
        "font.size": 11,
    }
    with matplotlib.rc_context(settings):
        drawing = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DOTS_PER_IN, layout="constrained")
        axes = drawing.add_subplot()
        colours: dict[str, str] = {}
        for curve in figure.curves:
            varied, _, method = curve.label.rpartition(", ")
            colour = colours.setdefault(varied, f"C{len(colours)}")
            style = "--" if method == "paper" else "-"
            values = [float("nan") if value is None else value for value in curve.y]
            axes.plot(curve.x, values, style, color=colour, marker="o", markersize=3.5, label=curve.label)
        for place in figure.x_lines:
            axes.axvline(place, color=ink, linewidth=1, linestyle=":")
        for height in figure.y_lines:
            axes.axhline(height, color=ink, linewidth=1, linestyle=":")
        axes.set(xlabel=figure.x_label, ylabel=figure.y_label, xscale=figure.x_scale, yscale=figure.y_scale)
        for axis, scale in ((axes.xaxis, figure.x_scale), (axes.yaxis, figure.y_scale)):
            if scale == "log":
                axis.set_major_formatter(FuncFormatter(plain))
                axis.set_minor_formatter(FuncFormatter(plain))
        axes.grid(True, which="both", color=ground)
        axes.patch.set_alpha(0)
        axes.legend(fontsize=8.5, loc="center left", bbox_to_anchor=(1.01, 0.5), framealpha=0)
        FigureCanvasAgg(drawing)
        written = io.BytesIO()
        drawing.savefig(written, format="png", transparent=True)
    return written.getvalue()


def plain(value: float, _: int | None = None) -> str:
    """Return the label of a tick on a logarithmic axis: 1, 2 and 5 of each decade, as plain numbers."""
    return f"{value:g}" if f"{value:e}"[0] in "125" and f"{value:.0e}"[0] in "125" else ""
