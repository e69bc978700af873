"""Total internal reflection: where a half ball sends no light into air, and what is made of the pixels there."""

from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from recon.evaluation.truth import TruthStatus
from recon.maps import MAPS_NAME, load_maps
from recon.run import run_session
from recon.running.settings import Settings
from recon.sessions.session import TRUTH_NAME
from recon.study.experiment import Findings, StudySize, Tell
from recon.study.photographed import METHODS, SMOOTH
from recon.study.scenes import HALF_BALL, half_ball
from recon.study.simulator import simulated
from recon.study.study_result import StudyTable

COLUMNS = 192


def total_reflection(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """A half ball, flat face to the camera: rays beyond the critical angle of 41.8° stay inside."""
    columns = size.columns_or(COLUMNS)
    scene = half_ball(size=columns)
    tell("simulating the photos")
    session = simulated(scene, folder / "total-reflection", options=[*SMOOTH, "--seed", str(size.seed)])
    with np.load(session / TRUTH_NAME) as arrays:
        status = arrays["status"]
    entry = entry_radius(columns)
    judged, lost = status == TruthStatus.JUDGED, status == TruthStatus.LOST_INSIDE
    rows = [
        ("critical angle (°)", float(np.degrees(np.arcsin(1 / HALF_BALL.n_object))), 41.8),
        ("light ends at this radius of the flat face: Snell's law", critical_entry_radius(), None),
        ("… the outermost pixel that is lit in all sets", float(entry[judged].max()), None),
        ("… the innermost pixel that is lost", float(entry[lost].min()), None),
        ("pixels lit in all sets", int(judged.sum()), None),
        ("pixels lost by total reflection", int(lost.sum()), None),
    ]
    for method in METHODS:
        tell(f"recon run --method {method}")
        out = folder / f"total-reflection/recon-{method}"
        run_session(session, out, Settings(method=method))
        found = load_maps(out / MAPS_NAME).valid()
        rows.append((f"{method}: lit pixels with a point (%)", 100 * float(found[judged].mean()), None))
        rows.append((f"{method}: lost pixels with a point, which is false", int(found[lost].sum()), None))
    table = StudyTable(title="Where the light ends", headings=("figure", "ours", "published"), rows=tuple(rows))
    setting = (
        f"A half ball of radius {HALF_BALL.radius:g} and index {HALF_BALL.n_object:g}, the camera {HALF_BALL.distance:g} "
        f"from its flat face, {columns} × {columns} pixels; photos with noise and JPEG."
    )
    return Findings(setting, (table,))


def entry_radius(columns: int) -> np.ndarray:
    """Return how far from the axis each pixel's centre meets the flat face [rows, cols]."""
    from_centre = np.arange(columns) - (columns - 1) / 2
    return np.hypot(*np.meshgrid(from_centre, from_centre)) * 2 * HALF_BALL.half_field / columns


def critical_entry_radius() -> float:
    """Return the radius on the flat face beyond which a ray meets the dome at more than the critical angle (Snell's law)."""
    n, radius, distance = HALF_BALL.n_object, HALF_BALL.radius, HALF_BALL.distance

    def beyond(entry: float) -> float:
        sine = entry / np.hypot(entry, distance) / n
        cosine = np.sqrt(1 - sine**2)
        along = -entry * sine + np.sqrt((entry * sine) ** 2 + radius**2 - entry**2)
        at = np.array([entry + along * sine, along * cosine]) / radius
        return float(np.arccos(at @ [sine, cosine]) - np.arcsin(1 / n))

    return float(brentq(beyond, 0.0, radius * (1 - 1e-9)))
