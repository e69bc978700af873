"""The page of a batch: every session's verdict in one table, and one strip a metric with the outliers to click."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from urllib.parse import quote

import numpy as np

from recon.errors import ReconError
from recon.metrics import Metrics
from recon.report.charts import Scale
from recon.report.numbers import LengthUnit, duration, memory, number, share
from recon.report.page import render_page
from recon.report.panel import Panel, Section

GROUP_NAME = "batch.html"
WIDTH, HEIGHT, EDGE = 900, 58, 12
LANES = 5
# 1.4826 medians of the absolute deviations are one standard deviation of a normal distribution; three of them are rare.
OUTLIER_DEVIATIONS = 3 * 1.4826
FEWEST_FOR_OUTLIERS = 5


@dataclass(frozen=True, slots=True)
class GroupRow:
    """One session of a batch: its numbers and its report, or the sentence that says why it has none.

    ``report`` is the path of its report relative to the folder of the batch page.
    """

    name: str
    metrics: Metrics | None
    report: PurePath | None = None
    fault: str = ""

    @property
    def address(self) -> str:
        """The report's address as a link from the batch page; empty where there is none."""
        return "./" + quote(self.report.as_posix()) if self.report else ""

    @property
    def grade(self) -> str:
        """The verdict's grade, or that there is no result."""
        return self.metrics.verdict.grade if self.metrics else "no result"


@dataclass(frozen=True, slots=True)
class Measure:
    """One number a session; NaN where a session has none."""

    id: str
    title: str
    values: tuple[float, ...]
    unit: str = ""


def write_group_report(path: Path, rows: Sequence[GroupRow]) -> Path:
    """Write the page of a batch and return its path; raises ``ReconError`` with one sentence when it cannot."""
    grades = [row.grade for row in rows]
    tiles = tuple(
        (title, number(grades.count(grade)), f"of {number(len(rows))} sessions")
        for grade, title in (("pass", "Pass"), ("check", "Check"), ("fail", "Fail"), ("no result", "No result"))
    )
    page = render_page(
        "Batch of sessions",
        kind="Batch report",
        subtitle=f"{number(len(rows))} sessions",
        sections=(sessions_section(rows), strips_section(rows)),
        tiles=tiles,
    )
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ReconError(f"{path}: the batch's page cannot be written ({error.strerror})") from error
    return path


def sessions_section(rows: Sequence[GroupRow]) -> Section:
    """Return the table of sessions, the worst first."""
    order = {"no result": 0, "fail": 1, "check": 2, "pass": 3}
    shown = [
        {
            "name": row.name,
            "address": row.address,
            "grade": row.grade,
            "why": " ".join(row.metrics.verdict.reasons) if row.metrics else row.fault,
            "points": number(row.metrics.funnel.normals) if row.metrics else "",
            "share": share(row.metrics.funnel.normals, row.metrics.funnel.lit) if row.metrics else "",
            "time": duration(_seconds(row.metrics)) if row.metrics else "",
        }
        for row in sorted(rows, key=lambda row: (order[row.grade], row.name))
    ]
    panel = Panel(
        "sessions",
        "",
        "sessions.html.j2",
        {"rows": shown},
        missing="" if rows else "The batch had no session.",
    )
    return Section("sessions", "Sessions", (panel,), "Worst first; a name leads to the session's own report.")


def strips_section(rows: Sequence[GroupRow]) -> Section:
    """Return one strip a metric over all sessions."""
    return Section(
        "strips",
        "One strip a metric",
        tuple(strip_panel(rows, measure) for measure in measures(rows)),
        "Each dot is a session; point at it to see its name. An outlier lies more than three robust standard deviations "
        "(1.4826 median absolute deviations) from the median and is named below its strip.",
    )


def measures(rows: Sequence[GroupRow]) -> tuple[Measure, ...]:
    """Return every number that the sessions have in common kind: points, statistics, saturation, time and memory."""
    units = {row.metrics.length_unit for row in rows if row.metrics}
    length = LengthUnit.of(units.pop()) if len(units) == 1 else LengthUnit("stored mm", False)
    named = {
        (each.name, each.unit): None for row in rows if row.metrics for each in row.metrics.statistics
    }  # in order of appearance
    found = [
        Measure("points", "Points with normals", _of(rows, lambda m: m.funnel.normals)),
        Measure(
            "kept",
            "Points as a share of the lit pixels",
            _of(rows, lambda m: 100 * m.funnel.normals / m.funnel.lit if m.funnel.lit else math.nan),
            "%",
        ),
    ]
    for place, (name, unit) in enumerate(named):
        values = _of(rows, _median_of(name))
        found.append(Measure(f"statistic-{place}", f"{name}, median", values, length.rename(unit)))
    found += [
        Measure(
            "saturated",
            "Worst photo's saturated share",
            _of(rows, lambda m: 100 * max((p.saturated_share for p in m.photos), default=math.nan)),
            "%",
        ),
        Measure("time", "Time", _of(rows, _seconds), "s"),
        Measure(
            "memory", "Peak memory", _of(rows, lambda m: max((s.peak_mb for s in m.stages), default=math.nan)), "MB"
        ),
    ]
    return tuple(found)


def outliers(values: Sequence[float]) -> list[int]:
    """Return the places of values far from the median in units of the median absolute deviation.

    Examples
    --------
    >>> outliers([1.0, 1.1, 0.9, 1.05, 0.95, 9.0])
    [5]
    """
    known = np.array(values, dtype=np.float64)
    fine = np.isfinite(known)
    if fine.sum() < FEWEST_FOR_OUTLIERS:
        return []
    middle = np.median(known[fine])
    deviation = np.abs(known - middle)
    limit = OUTLIER_DEVIATIONS * np.median(deviation[fine])
    return [int(place) for place in np.flatnonzero(fine & (deviation > limit))] if limit > 0 else []


def strip_panel(rows: Sequence[GroupRow], measure: Measure) -> Panel:
    """Return one metric as a strip of dots."""
    known = [(place, value) for place, value in enumerate(measure.values) if math.isfinite(value)]
    far = set(outliers(measure.values))
    data: dict[str, object] = {}
    if known:
        low, high = min(value for _, value in known), max(value for _, value in known)
        # Where all are equal the axis has one place, whatever its width.
        room = 0.04 * (high - low) or abs(high) * 0.1 or 1.0
        scale = Scale(low - room, high + room, EDGE, WIDTH - EDGE)
        # Sorted and dealt out to lanes, so that neighbours do not cover each other.
        ranked = sorted(known, key=lambda item: item[1])
        dots = [
            {
                "x": scale.place(value),
                "y": 9 + 6 * (rank % LANES),
                "name": rows[place].name,
                "value": written(value, measure.unit),
                "address": rows[place].address,
                "grade": rows[place].grade.replace(" ", "-"),
                "far": place in far,
            }
            for rank, (place, value) in enumerate(ranked)
        ]
        middle = float(np.median([value for _, value in known]))
        data = {
            "dots": dots,
            "size": (WIDTH, HEIGHT),
            "middle": scale.place(middle),
            "ticks": scale.ticks(6) if high > low else [(scale.place(high), written(high, ""))],
            "label": f"{measure.title}: {len(known)} sessions from {written(low, measure.unit)} to "
            f"{written(high, measure.unit)}, median {written(middle, measure.unit)}",
        }
    title = f"{measure.title} ({measure.unit})" if measure.unit else measure.title
    return Panel(
        f"strip-{measure.id}", title, "strip.html.j2", data, missing="" if known else "No session has this number."
    )


def written(value: float, unit: str) -> str:
    """Write a value with its unit."""
    if unit == "s":
        return duration(value)
    if unit == "MB":
        return memory(value)
    whole = number(int(value)) if not unit and value.is_integer() else number(value)
    return f"{whole} {unit}".strip()


def _median_of(name: str) -> Callable[[Metrics], float]:
    """Return what reads the median of the statistic ``name``."""
    return lambda metrics: next((each.median for each in metrics.statistics if each.name == name), math.nan)


def _seconds(metrics: Metrics) -> float:
    return float(sum(stage.wall_s for stage in metrics.stages))


def _of(rows: Sequence[GroupRow], measure: Callable[[Metrics], float]) -> tuple[float, ...]:
    return tuple(float(measure(row.metrics)) if row.metrics else math.nan for row in rows)
