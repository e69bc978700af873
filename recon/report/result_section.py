"""What came out: the funnel from pixels to normals, and the error statistics with how each was computed."""

from collections.abc import Mapping, Sequence

from recon.metrics import Funnel, Metrics
from recon.report.numbers import NOTHING, LengthUnit, number, share
from recon.report.panel import Panel, Section, Table
from recon.report.registration_panel import registration_panel

STEPS = (
    ("pixels", "Pixels of the photo", "all of them"),
    ("lit", "Lit", "saw the stripe in at least one set"),
    ("matched", "Matched in all sets", "have a place on the display in each of the four sets"),
    ("entry_points", "First entry points", "their two light paths meet, between display and camera"),
    ("normals", "Normals", "have a point and a direction of the surface"),
)


def funnel_panel(funnel: Funnel, *, thin: bool) -> Panel:
    """Return the steps from pixels to normals with what is lost at each."""
    counts = [int(getattr(funnel, name)) for name, _, _ in STEPS]
    steps = [
        {
            "name": title,
            "note": note,
            "count": count,
            "width": 100 * count / (counts[0] or 1),
            "of_before": share(count, before),
            "lost": before - count,
        }
        for (_, title, note), count, before in zip(STEPS, counts, [counts[0], *counts[:-1]], strict=True)
    ]
    beside = (
        "" if thin else "Pixels that look past the object at the liquid’s surface drop out at “First entry points”."
    )
    return Panel(
        "funnel",
        "From pixels to normals",
        "funnel.html.j2",
        {"steps": steps, "total": counts[0]},
        "How many pixels are left after each step; the bars share one scale. " + beside,
        "Of the object’s pixels almost none is lost after “Lit”: the paper kept 94.5 to 97.7 % of its correspondences as points.",
        "A large loss at “Matched” (light missing in one set: exposure, a bubble, the liquid’s level) or at “First entry points” "
        "(poses, or an object that moved).",
    )


def statistics_panel(metrics: Metrics, unit: LengthUnit) -> Panel:
    """Return the spread of every measured error."""
    rows = tuple(
        (
            each.name,
            *(number(float(value)) for value in (each.mean, each.median, each.rms, each.p95)),
            unit.rename(each.unit),
            each.how,
        )
        for each in metrics.statistics
    )
    return Panel(
        "statistics",
        "Error statistics",
        "table.html.j2",
        {
            "table": Table(
                ("Quantity", "Mean", "Median", "RMS", "95th pct.", "Unit", "How it was computed"), rows, (1, 2, 3, 4)
            )
        },
        "Over all pixels that have a point.",
        "Mean and median agree with what the correspondence noise explains, and the 95th percentile is a few times the median.",
        "Mean far above the median (outliers), or a median that the noise cannot explain (an offset: a pose or the index).",
        missing="" if rows else "The run recorded no statistics; no pixel may have had a point.",
    )


def evaluation_panel(rows: Sequence[Mapping[str, object]], unit: LengthUnit) -> Panel:
    """Return the comparison with a fitted primitive or with the truth; columns are the keys, in order of appearance."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    cells = tuple(tuple(_cell(row.get(key)) for key in keys) for row in rows)
    numeric = tuple(
        place for place, key in enumerate(keys) if any(isinstance(row.get(key), int | float) for row in rows)
    )
    return Panel(
        "evaluation",
        "Comparison with a fitted primitive or with the truth",
        "table.html.j2",
        {"table": Table(tuple(heading(key, unit) for key in keys), cells, numeric)},
        "Errors as in the paper's tables: against the primitive fitted to the points, or against a known surface.",
        "The paper's hemisphere: position 0.59 mm mean, 0.42 mm median; normal 6.97° mean, 6.92° median.",
        "Mean and median of the normal error almost equal: that is an offset, not noise; look at the poses and the index.",
        missing=""
        if rows
        else "No evaluation was made. `recon evaluate` fits a sphere, plane or cylinder, or compares with a truth file.",
    )


def heading(key: str, unit: LengthUnit) -> str:
    """Turn a field's name into a heading with its unit.

    Examples
    --------
    >>> heading("position_rms_mm", LengthUnit("mm", True)), heading("normal_median_deg", LengthUnit("mm", True))
    ('position rms (mm)', 'normal median (°)')
    """
    words = key.split("_")
    units = {"mm": unit.label, "deg": "°", "rad": "rad", "px": "px", "s": "s", "percent": "%"}
    if len(words) > 1 and words[-1] in units:
        return f"{' '.join(words[:-1])} ({units[words[-1]]})"
    return " ".join(words)


def _cell(value: object) -> str:
    """Write any value of an evaluation row."""
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return number(value)
    if isinstance(value, list | tuple):
        return ", ".join(_cell(part) for part in value)
    return str(value)


def result_section(
    metrics: Metrics, *, unit: LengthUnit, thin: bool, evaluation: Sequence[Mapping[str, object]]
) -> Section:
    """Return the section of results in numbers."""
    return Section(
        "results",
        "Results in numbers",
        (
            funnel_panel(metrics.funnel, thin=thin),
            statistics_panel(metrics, unit),
            *(() if thin else (registration_panel(metrics, unit),)),
            evaluation_panel(evaluation, unit),
        ),
    )
