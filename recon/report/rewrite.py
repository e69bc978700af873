"""Write a run's report again from the files in its folder, now with an evaluation."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from recon.calibration.calibration_file import CALIBRATION_NAME, read_calibration
from recon.maps import MAPS_NAME, load_maps
from recon.metrics import METRICS_NAME, load_metrics
from recon.report.writer import REPORT_NAME, write_report
from recon.running.kept_stages import keep_rewritten
from recon.sessions.session import MANIFEST_NAME, parse_manifest
from recon.surface.files import MESH_NAME, read_mesh_ply


def rewrite_report(run_folder: Path, evaluation: Sequence[Mapping[str, object]]) -> Path | None:
    """Write ``report.html`` again with these rows; None where the folder holds maps but was not made by ``recon run``."""
    source = run_folder / MANIFEST_NAME
    if not source.exists() or not (run_folder / REPORT_NAME).exists():
        return None
    calibration = run_folder / CALIBRATION_NAME
    mesh_file = run_folder / MESH_NAME
    mesh = None
    if mesh_file.exists():
        loaded = read_mesh_ply(mesh_file)
        mesh = (loaded.vertices_mm, loaded.faces, loaded.normal)
    path = write_report(
        run_folder,
        maps=load_maps(run_folder / MAPS_NAME),
        metrics=load_metrics(run_folder / METRICS_NAME),
        manifest=parse_manifest(source.read_text(encoding="utf-8"), source=str(source)),
        mesh=mesh,
        evaluation=evaluation,
        calibration=read_calibration(calibration) if calibration.is_file() else None,
    )
    keep_rewritten(run_folder, REPORT_NAME)
    return path
