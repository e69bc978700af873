"""How the forms of a thin object's surface compare, on simulated plates with a flat face towards the camera."""

from pathlib import Path
from typing import get_args

import numpy as np

from recon.method import ThinForm
from recon.sessions.manifest import FlatFace, Manifest
from recon.study.experiment import Tell
from recon.study.noisy_sweeps import load_true_session, noisy_sweeps
from recon.study.simulator import simulated
from recon.study.study_result import Cell, StudyTable
from recon.surface.thin_stage import thin_object

FORMS: tuple[ThinForm, ...] = get_args(ThinForm)
# Both have their flat face in the plane z = 0 of their scenes.
OBJECTS = ("plate_round", "plate_fish")
SIGMAS = (0.02, 0.1)
# Steeper than this against the axis, a true normal is that of the rim.
FACE_COSINE = 0.5


def thin_forms(folder: Path, columns: int, rng: np.random.Generator, tell: Tell) -> StudyTable:
    """Reconstruct thin objects by method ``full`` with each form, from true correspondences with noise."""
    rows: list[tuple[Cell, ...]] = []
    for name in OBJECTS:
        words = ["--truth-only", "--size", str(columns)]
        session = load_true_session(simulated(name, folder / f"form-{name}", options=words))
        truth = session.truth
        for sigma_px in SIGMAS:
            tell(f"{name}, noise of {sigma_px:g} px")
            sweeps = noisy_sweeps(session, sd_px=sigma_px, rng=rng)
            for known in (True, False):
                manifest = with_flat_face(session.manifest) if known else session.manifest
                places, shapes = [], []
                for form in FORMS:
                    maps = thin_object(sweeps, manifest, method="full", integration=form).maps
                    judged = truth.judged & maps.valid() & (truth.normal[..., 2] > FACE_COSINE)
                    off = (maps.point_mm - truth.point_mm)[judged][:, 2]
                    places.append(float(np.median(off)))
                    shapes.append(float(np.abs(off - places[-1]).mean()))
                rows.append((name, "known" if known else "unknown", sigma_px, *shapes, *places))
    return StudyTable(
        title="A thin object's surface, method full (scene units or mm)",
        headings=(
            "object",
            "flat face",
            "σ (px)",
            *(f"{form}: shape" for form in FORMS),
            *(f"{form}: place" for form in FORMS),
        ),
        rows=tuple(rows),
        note="Place: the median error along the axis. Shape: the mean absolute error once that is taken off.",
    )


def with_flat_face(manifest: Manifest) -> Manifest:
    """Return the manifest of an object whose face towards the camera is known to be the plane z = 0."""
    face = FlatFace(point_mm=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
    return manifest.model_copy(update={"object": manifest.object.model_copy(update={"flat_face": face})})
