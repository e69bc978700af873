"""An evaluation's figures as people read them: a table for the terminal, rows for the report."""

import math
from collections.abc import Iterator

from rich.table import Table

from recon.evaluation.evaluate import EvaluationResult
from recon.evaluation.published import CITATION
from recon.evaluation.table import Row


def evaluation_table(result: EvaluationResult) -> Table:
    """Lay the figures out for the terminal; the published column appears where there is something in it."""
    beside = any(row.published for row in result.rows)
    table = Table(
        title=f"{result.run} (method {result.method})",
        caption=f"published: {CITATION}" if beside else None,
        title_justify="left",
        caption_justify="left",
    )
    table.add_column("of")
    table.add_column("quantity")
    table.add_column("ours", justify="right")
    if beside:
        table.add_column("published", justify="right")
    table.add_column("unit")
    for before, row in zip([None, *result.rows], result.rows, strict=False):
        if before is not None and before.of != row.of:
            table.add_section()
        table.add_row(*_cells(row, repeated=before is not None and before.of == row.of, beside=beside))
    return table


def _cells(row: Row, *, repeated: bool, beside: bool) -> Iterator[str]:
    yield "" if repeated else row.of
    yield row.quantity
    yield figure(row.ours)
    if beside:
        yield "" if row.published is None else _range(*row.published)
    yield row.unit


def _range(low: float, high: float) -> str:
    return figure(low) if low == high else f"{figure(low)} … {figure(high)}"


def figure(value: float | int) -> str:
    """Write four significant digits, whole numbers in full.

    Examples
    --------
    >>> figure(1115748.0), figure(0.031415926), figure(float("nan"))
    ('1,115,748', '0.03142', 'none')
    """
    if math.isnan(value):
        return "none"
    return f"{value:,.0f}" if value == round(value) and abs(value) >= 1 else f"{value:.4g}"


def report_row(row: Row, length_unit: str) -> dict[str, object]:
    """Return a row of the report."""
    published = "" if row.published is None else _range(*row.published)
    return {
        "of": row.of,
        "quantity": row.quantity,
        "ours": figure(row.ours),
        "published": published,
        "unit": length_unit if row.unit == "mm" else row.unit,
    }
