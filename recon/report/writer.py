"""Write ``report.html`` for one reconstruction."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.calibration.calibration_file import Calibration
from recon.errors import ReconError
from recon.maps import Maps
from recon.media.stated_index import with_index
from recon.metrics import Metrics
from recon.report.capture_section import capture_section
from recon.report.map_section import map_section
from recon.report.methods_section import methods_section
from recon.report.numbers import NOTHING, LengthUnit, duration, number, share
from recon.report.page import render_page
from recon.report.panel import Banner, Section
from recon.report.result_section import result_section
from recon.report.run_section import device_banners, run_section, warnings_section
from recon.report.setup_section import setup_section
from recon.report.views import Mesh, ReportViews, report_views
from recon.sessions.manifest import Manifest

REPORT_NAME = "report.html"
# Mail servers and review systems refuse larger attachments.
LIMIT_BYTES = 10_000_000
# Samples along the longer side of a map, one after the other where the page would be too large with those of the views.
SMALLER_PX = (600, 350)


def write_report(
    out_dir: Path,
    *,
    maps: Maps,
    metrics: Metrics,
    manifest: Manifest,
    mesh: Mesh | None,
    evaluation: Sequence[Mapping[str, object]] = (),
    calibration: Calibration | None = None,
    views: ReportViews | None = None,
) -> Path:
    """Write ``report.html`` into ``out_dir`` and return its path.

    Parameters
    ----------
    out_dir:
        An existing folder.
    maps, metrics, manifest:
        The result, its numbers, and the session's manifest.
    mesh:
        Vertices, faces and normals in the frame of ``maps``, or None where no surface was made.
    evaluation:
        One mapping a fitted primitive or comparison; its keys become the columns, and an ending such as ``_mm`` or ``_deg``
        becomes the unit in the heading.
    calibration:
        The calibration that the poses come from; its page, ``calibration.html``, is expected beside the report.
    views:
        The views of these maps and this mesh, if they are already drawn.

    Raises
    ------
    ReconError
        When the file cannot be written, in one sentence.
    """
    if not out_dir.is_dir():
        raise ReconError(f"{out_dir}: no such folder; the report is written beside the other results")
    if metrics.liquid_index is not None:
        manifest = with_index(manifest, metrics.liquid_index.n)
    unit = LengthUnit.of(manifest.length_unit)
    if views is None:
        views = report_views(maps, manifest, mesh)
    before = (
        warnings_section(metrics),
        views.surface,
        result_section(metrics, unit=unit, thin=manifest.method == "thin", evaluation=evaluation),
    )
    after = (
        capture_section(metrics, unit=unit),
        setup_section(manifest, maps, metrics, unit=unit, calibration=calibration),
        run_section(metrics, manifest),
        methods_section(manifest, metrics, unit=unit),
    )

    def page_with(pictures: Section) -> str:
        return render_page(
            metrics.session,
            kind="Reconstruction report",
            subtitle=subtitle(metrics, manifest),
            sections=(*before, pictures, *after),
            banners=(*device_banners(manifest), *unit_banners(unit)),
            verdict=metrics.verdict,
            tiles=tiles(maps, metrics, unit),
            scripts=("page.js", "viewer.js"),
        )

    page = page_with(views.maps)
    for longest_px in SMALLER_PX:
        if len(page.encode()) < LIMIT_BYTES:
            break
        page = page_with(map_section(maps, manifest, unit=unit, longest_px=longest_px))
    path = out_dir / REPORT_NAME
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ReconError(f"{path}: the report cannot be written ({error.strerror})") from error
    return path


def subtitle(metrics: Metrics, manifest: Manifest) -> str:
    """Return object, date and method in one line."""
    try:
        created = datetime.fromisoformat(manifest.created)
        date = f"{created.day} {created:%B %Y, %H:%M %Z}".strip()
    except ValueError:
        date = manifest.created or "at an unknown time"
    named = [manifest.object.name] if manifest.object.name != metrics.session else []
    return " · ".join([*named, f"captured {date}", f"reconstructed by the method “{metrics.method}”"])


def unit_banners(unit: LengthUnit) -> tuple[Banner, ...]:
    """Return the line that keeps a reader from taking scene units for millimetres."""
    if unit.physical:
        return ()
    text = "This session has no physical unit of length: one scene unit is stored as 1 mm in every file (fields named _mm)."
    return (Banner("Lengths are in scene units.", text, False),)


def tiles(maps: Maps, metrics: Metrics, unit: LengthUnit) -> tuple[tuple[str, str, str], ...]:
    """Return the few numbers that a reader looks for first."""
    funnel = metrics.funnel
    sd = maps.sd_mm[maps.valid() & np.isfinite(maps.sd_mm)]
    gap = maps.gap_mm[maps.valid() & np.isfinite(maps.gap_mm)]
    count = len(metrics.warnings)
    warnings = "no warnings" if not count else f"{number(count)} warning{'s' if count > 1 else ''}"
    return (
        ("Points with normals", number(funnel.normals), f"{share(funnel.normals, funnel.lit)} of the lit pixels"),
        ("Standard deviation", _median(sd), f"{unit.label}, median of the points" if sd.size else "not estimated"),
        ("Gap between paths", _median(np.abs(gap)), f"{unit.label}, median of its size"),
        ("Time", duration(sum(stage.wall_s for stage in metrics.stages)), warnings),
    )


def _median(values: Float[np.ndarray, " values"]) -> str:
    return number(float(np.median(values))) if values.size else NOTHING
