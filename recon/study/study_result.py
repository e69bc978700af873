"""What a study gives: tables and curves, kept as JSON and shown on a page."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

Cell = float | int | str | None


class Part(BaseModel):
    """A part of a result: immutable, and strict about its fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class StudyTable(Part):
    """Rows under headings; a number is shown with four significant digits, ``None`` as a dash."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


class Curve(Part):
    """One line of a figure."""

    label: str
    x: tuple[float, ...]
    y: tuple[float | None, ...]


class StudyFigure(Part):
    """Curves over one axis, drawn like those of the paper; ``x_lines`` and ``y_lines`` are limits to compare with."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    y_scale: Literal["linear", "log"] = "log"
    x_scale: Literal["linear", "log"] = "linear"
    x_lines: tuple[float, ...] = ()
    y_lines: tuple[float, ...] = ()


class StudyResult(Part):
    """One experiment: what it is, how to repeat it, and what was seen."""

    name: str
    title: str
    setting: str
    command: str
    seconds: float
    tables: tuple[StudyTable, ...]
    figures: tuple[StudyFigure, ...] = ()


def cell_text(value: Cell) -> str:
    """Return a cell as it is shown.

    Examples
    --------
    >>> cell_text(0.0123456), cell_text(1234567), cell_text(None)
    ('0.01235', '1,234,567', '–')
    """
    if value is None or value != value:
        return "–"
    if isinstance(value, str):
        return value
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}"


def markdown(result: StudyResult) -> str:
    """Return the result as a page in Markdown, with the command that repeats it."""
    lines = [f"## {result.title}", "", result.setting, "", "```console", f"$ {result.command}", "```"]
    for table in result.tables:
        lines += ["", f"**{table.title}**", "", "| " + " | ".join(table.headings) + " |"]
        lines.append("|" + "---|" * len(table.headings))
        lines += ["| " + " | ".join(cell_text(value) for value in row) + " |" for row in table.rows]
        if table.note:
            lines += ["", table.note]
    return "\n".join(lines) + "\n"
