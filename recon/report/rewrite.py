"""Write a run's report again from the files in its folder, now with an evaluation."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh

from recon.calibration.calibration_file import CALIBRATION_NAME, read_calibration
from recon.maps import MAPS_NAME, load_maps
from recon.metrics import METRICS_NAME, load_metrics
from recon.report.writer import REPORT_NAME, write_report
from recon.sessions.session import MANIFEST_NAME, parse_manifest


def rewrite_report(run_folder: Path, evaluation: Sequence[Mapping[str, object]]) -> Path | None:
    """Write ``report.html`` again with these rows; None where the folder holds maps but was not made by ``recon run``."""
    source = run_folder / MANIFEST_NAME
    if not source.exists() or not (run_folder / REPORT_NAME).exists():
        return None
    calibration = run_folder / CALIBRATION_NAME
    mesh_file = run_folder / "mesh.ply"
    mesh = None
    if mesh_file.exists():
        loaded = trimesh.load_mesh(mesh_file, process=False)
        mesh = (
            np.asarray(loaded.vertices, dtype=np.float64),
            np.asarray(loaded.faces, dtype=np.int32),
            np.asarray(loaded.vertex_normals, dtype=np.float64),
        )
    return write_report(
        run_folder,
        maps=load_maps(run_folder / MAPS_NAME),
        metrics=load_metrics(run_folder / METRICS_NAME),
        manifest=parse_manifest(source.read_text(encoding="utf-8"), source=str(source)),
        mesh=mesh,
        evaluation=evaluation,
        calibration=read_calibration(calibration) if calibration.is_file() else None,
    )
