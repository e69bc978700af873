"""The paper's thin objects: a cone on padding of growing height, and a shell of growing shift, with noise."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from recon.method import Method
from recon.study.experiment import Findings, StudySize, Tell
from recon.study.noise_rounds import METHODS, MethodErrors, noise_rounds
from recon.study.noisy_sweeps import load_true_session
from recon.study.scenes import thin_cone, thin_shell
from recon.study.simulator import Scene, simulated
from recon.study.study_result import Curve, StudyFigure, StudyTable

SIGMAS = (0.0, 0.1, 0.2, 0.5, 1.0)
LEAST_SIGMA = 1e-3  # the weights of a noise of nought would be infinite
PADDINGS = (0.0, 0.5, 1.0, 2.0)
SHIFTS = (1.0, 2.0, 3.0, 4.0, 5.0)
COLUMNS, ROUNDS = 128, 3
PAPER_LIMIT = "The paper: below 2° without padding, growing with the thickness. One refraction is assumed."
Errors = Mapping[Method, MethodErrors]


def cone_by_padding(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """A right circular cone (height 1, radius 4, index 1.7) padded by a cylinder of height 0, 0.5, 1 or 2."""
    scenes = {f"padding {height:g}": thin_cone(size=size.columns_or(COLUMNS), padding=height) for height in PADDINGS}
    return _study(folder, size, scenes, "padding", tell, PAPER_LIMIT)


def shell_by_shift(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """A ball of radius 10 less the same ball shifted by 1 to 5 along the line of sight, index 1.7."""
    scenes = {f"shift {shift:g}": thin_shell(size=size.columns_or(COLUMNS), shift=shift) for shift in SHIFTS}
    note = "The paper: the error falls, then rises again beyond a shift of about 3."
    return _study(folder, size, scenes, "shift", tell, note)


def _study(folder: Path, size: StudySize, scenes: Mapping[str, Scene], varied: str, tell: Tell, note: str) -> Findings:
    rounds, columns = size.rounds_or(ROUNDS), size.columns_or(COLUMNS)
    found: dict[tuple[str, float], Errors] = {}
    for number, (label, scene) in enumerate(scenes.items()):
        session = load_true_session(simulated(scene, folder / f"{varied}-{number}", options=["--truth-only"]))
        rng = np.random.default_rng(size.seed)
        for sigma in SIGMAS:
            tell(f"{label}, noise of {sigma:g} steps")
            found[label, sigma] = noise_rounds(session, sd_px=max(sigma, LEAST_SIGMA), rounds=rounds, rng=rng)
    rows = tuple(
        (
            label,
            sigma,
            each["paper"].normal_mean_deg,
            each["paper"].normal_rms_deg,
            each["full"].normal_mean_deg,
            each["full"].normal_rms_deg,
            100 * each["full"].kept,
        )
        for (label, sigma), each in found.items()
    )
    headings = (varied, "σ (steps)", "paper: mean (°)", "RMS (°)", "full: mean (°)", "RMS (°)", "kept (%)")
    figure = StudyFigure(
        title="Normal",
        x_label=f"{varied} (units)",
        y_label="mean error of normals (degrees)",
        curves=tuple(
            Curve(
                label=f"σ = {sigma:g}, {method}",
                x=tuple(float(label.split()[-1]) for label in scenes),
                y=tuple(found[label, sigma][method].normal_mean_deg for label in scenes),
            )
            for method in METHODS
            for sigma in (SIGMAS[0], SIGMAS[-1])
        ),
    )
    setting = (
        f"{columns} × {columns} camera pixels, Gaussian noise drawn anew in each of {rounds} rounds on the true "
        "correspondences of all four sets, with and without the object."
    )
    table = StudyTable(title="Error of the normals", headings=headings, rows=rows, note=note)
    return Findings(setting, (table,), (figure,))
