"""What is resolved through photos: a camera pixel sees a patch of the ripples, whose slopes spread its light over the display."""

from pathlib import Path

import numpy as np

from recon.evaluation.truth import load_truth
from recon.maps import MAPS_NAME, load_maps
from recon.run import run_session
from recon.running.settings import Settings
from recon.sessions.session import open_session
from recon.study.experiment import Findings, StudySize, Tell
from recon.study.height_transfer import height_transfer
from recon.study.photographed import METHODS, SMOOTH
from recon.study.resolution import SERIES, judged_face, ripples, series_of
from recon.study.simulator import simulated
from recon.study.study_result import Cell, StudyTable
from recon.study.wedge_scenes import AMPLITUDE_MM, Wedge, rippled_wedge

WAVELENGTHS_PX = (6.0, 12.0, 20.0)
COLUMNS, DISPLAY_COLUMNS = 64, 512


def resolution_by_photos(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """Ripples of 6, 12 and 20 pixels on the leaning face, photographed and reconstructed as any session is."""
    wedge = Wedge(size.columns_or(COLUMNS))
    words = [*SMOOTH, "--display-columns", str(DISPLAY_COLUMNS), "--seed", str(size.seed)]
    rows: list[tuple[Cell, ...]] = []
    for wavelength_px in WAVELENGTHS_PX:
        where = folder / f"photographed-{wavelength_px:g}"
        tell(f"ripples of {wavelength_px:g} px: simulating the photos")
        scene = rippled_wedge(wedge, wavelength_mm=wavelength_px * wedge.footprint_mm)
        session = simulated(scene, where, options=words)
        found = {}
        for method in METHODS:
            tell(f"ripples of {wavelength_px:g} px: recon run --method {method}")
            out = where / f"recon-{method}"
            run_session(session, out, Settings(method=method))
            found[method] = load_maps(out / MAPS_NAME)
        truth = load_truth(session)
        face = judged_face(truth, wedge)
        points = series_of(found["paper"], found["full"], open_session(session).manifest.camera)
        figures: list[float] = []
        for name in SERIES:
            transfer = height_transfer([ripples(points[name], truth, face, wedge)])
            figures += [transfer.ratio, transfer.sd, 100 * float(np.isfinite(points[name][face]).all(axis=1).mean())]
        rows.append((wavelength_px, *figures))
    headings = ("wavelength (px)", *(word for name in SERIES for word in (name, "sd", "complete (%)")))
    setting = (
        f"The wedge of the study of resolution, {wedge.columns} × {wedge.columns} photos with noise and JPEG of a display of "
        f"{DISPLAY_COLUMNS} columns, a raised cosine of 6 device pixels; ripples of {AMPLITUDE_MM:g} mm."
    )
    return Findings(setting, (StudyTable(title="Height found over true height", headings=headings, rows=tuple(rows)),))
