"""What a batch came to as a whole: ``batch.csv`` for programs and ``batch.html`` for people."""

import csv
import io
from collections.abc import Mapping
from pathlib import PurePath

from recon.batch.batch_record import Batch
from recon.batch.session_status import SessionStatus
from recon.metrics import Metrics
from recon.report.group import GROUP_NAME, GroupRow, write_group_report
from recon.report.writer import REPORT_NAME
from recon.sessions.disk import Disk, write_whole

TABLE_NAME = "batch.csv"


def write_group_files(batch: Batch, statuses: Mapping[str, SessionStatus]) -> tuple[GroupRow, ...]:
    """Write table and page of all sessions; return the page's rows."""
    metrics = {name: batch.metrics_of(name) if status.state == "done" else None for name, status in statuses.items()}
    text = table(statuses, metrics)
    write_whole(batch.folder / TABLE_NAME, text.encode("utf-8"), disk=Disk())
    rows = tuple(_row(name, status, metrics[name]) for name, status in statuses.items())
    write_group_report(batch.folder / GROUP_NAME, rows)
    return rows


def _row(name: str, status: SessionStatus, metrics: Metrics | None) -> GroupRow:
    if metrics is None:
        return GroupRow(name, None, fault=why_no_result(status))
    return GroupRow(name, metrics, PurePath(name) / REPORT_NAME)


def why_no_result(status: SessionStatus) -> str:
    """Say why a session has no result."""
    return {
        "failed": status.fault,
        "done": "its metrics.json cannot be read; run it again",
        "waiting": "not begun; `recon batch --resume` goes on with it",
        "running": "still running on its worker when the batch was left",
        "stopped": "stopped by Ctrl-C; `recon batch --resume` begins it anew",
    }[status.state]


def table(statuses: Mapping[str, SessionStatus], metrics: Mapping[str, Metrics | None]) -> str:
    """Return the table as CSV, one line a session; a cell is empty where there is no such number."""
    named = {
        (one.name, one.unit): f"{one.name.lower().replace(' ', '_')}_median_{one.unit}"
        for found in metrics.values()
        if found is not None
        for one in found.statistics
    }
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = ("session", "state", "grade", "pixels", "lit", "matched", "entry_points", "normals")
    writer.writerow([*columns, *named.values(), "wall_s", "peak_mb", "attempts", "why", "folder"])
    for name, status in statuses.items():
        writer.writerow([name, status.state, *_numbers(metrics[name], tuple(named)), *_story(status, metrics[name])])
    return text.getvalue()


def _numbers(metrics: Metrics | None, named: tuple[tuple[str, str], ...]) -> list[object]:
    if metrics is None:
        return [""] * (6 + len(named) + 2)
    funnel = metrics.funnel
    medians = {(one.name, one.unit): one.median for one in metrics.statistics}
    return [
        metrics.verdict.grade,
        *(funnel.pixels, funnel.lit, funnel.matched, funnel.entry_points, funnel.normals),
        *(f"{medians[key]:.6g}" if key in medians else "" for key in named),
        f"{sum(stage.wall_s for stage in metrics.stages):.3f}",
        f"{max((stage.peak_mb for stage in metrics.stages), default=0.0):.0f}",
    ]


def _story(status: SessionStatus, metrics: Metrics | None) -> list[object]:
    why = " ".join(metrics.verdict.reasons) if metrics is not None else why_no_result(status)
    return [len(status.attempts), why, status.session]
