"""The paper's noise experiments on the semi-ellipsoid: noise against baseline, and noise against the liquid's index."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from recon.method import Method
from recon.study.coverage_tables import coverage_tables
from recon.study.experiment import Findings, StudySize, Tell
from recon.study.noise_rounds import METHODS, MethodErrors, noise_rounds
from recon.study.noisy_sweeps import load_true_session
from recon.study.scenes import DISPLAY_PIXELS, DISPLAY_UNITS, semi_ellipsoid
from recon.study.simulator import Scene, simulated
from recon.study.study_result import Curve, StudyFigure, StudyTable

STEP_SIGMAS = tuple(round(0.1 * k, 1) for k in range(1, 11))
UNIT_SIGMAS = (0.1, 0.4, 0.7, 1.0)
STEPS_A_UNIT = DISPLAY_PIXELS / DISPLAY_UNITS
BASELINES = (15.0, 20.0, 25.0, 30.0)
INDICES = (1.3, 1.5, 1.7)
COLUMNS, ROUNDS = 128, 5
Errors = Mapping[Method, MethodErrors]


def noise_by_baseline(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """Noise on the correspondences, with position 0 at z = 10 and position 1 at 15, 20, 25 or 30."""
    columns = size.columns_or(COLUMNS)
    scenes = {f"z₁ = {far:g}": semi_ellipsoid(size=columns, stage=(10.0, far), n_liquid=1.3) for far in BASELINES}
    return _study(folder, size, scenes, "baseline", tell)


def noise_by_index(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """Noise on the correspondences, in liquids of index 1.3, 1.5 and 1.7, with the display at z = 6 and 10."""
    columns = size.columns_or(COLUMNS)
    scenes = {f"n = {n:g}": semi_ellipsoid(size=columns, stage=(6.0, 10.0), n_liquid=n) for n in INDICES}
    return _study(folder, size, scenes, "liquid", tell)


def _study(folder: Path, size: StudySize, scenes: Mapping[str, Scene], varied: str, tell: Tell) -> Findings:
    rounds, columns = size.rounds_or(ROUNDS), size.columns_or(COLUMNS)
    steps: dict[tuple[str, float], Errors] = {}
    units: dict[tuple[str, float], Errors] = {}
    for number, (label, scene) in enumerate(scenes.items()):
        session = load_true_session(simulated(scene, folder / f"{varied}-{number}", options=["--truth-only"]))
        rng = np.random.default_rng(size.seed)
        for sigma in STEP_SIGMAS:
            tell(f"{label}, noise of {sigma:g} steps")
            steps[label, sigma] = noise_rounds(session, sd_px=sigma, rounds=rounds, rng=rng)
        for sigma in UNIT_SIGMAS:
            tell(f"{label}, noise of {sigma:g} units")
            units[label, sigma] = noise_rounds(session, sd_px=sigma * STEPS_A_UNIT, rounds=rounds, rng=rng)
    setting = (
        f"The semi-ellipsoid, {columns} × {columns} camera pixels, Gaussian noise drawn anew in each "
        f"of {rounds} rounds on the true correspondences of all four sets. Both methods are judged on the same "
        "pixels: those that pass the tests of method `paper`."
    )
    return Findings(
        setting,
        (
            _table("Noise in stripe steps (1/32 unit)", varied, steps),
            *coverage_tables(varied, steps),
            _table("Noise in scene units", varied, units, "32 stripe steps a unit: the paths hardly meet any more."),
        ),
        (
            _figure("Position", "RMS of positions (units)", steps, "position_rms"),
            _figure("Normal", "RMS of normals (degrees)", steps, "normal_rms_deg"),
        ),
    )


def _table(title: str, varied: str, errors: Mapping[tuple[str, float], Errors], note: str = "") -> StudyTable:
    headings = (
        varied,
        "σ",
        "position RMS paper",
        "full",
        "paper / full",
        "normal RMS paper (°)",
        "full (°)",
        "kept (%)",
    )
    rows = tuple(
        (
            label,
            sigma,
            each["paper"].position_rms,
            each["full"].position_rms,
            each["paper"].position_rms / each["full"].position_rms,
            each["paper"].normal_rms_deg,
            each["full"].normal_rms_deg,
            100 * each["full"].kept,
        )
        for (label, sigma), each in errors.items()
    )
    return StudyTable(title=title, headings=headings, rows=rows, note=note)


def _figure(title: str, y_label: str, errors: Mapping[tuple[str, float], Errors], quantity: str) -> StudyFigure:
    labels = dict.fromkeys(label for label, _ in errors)
    curves = tuple(
        Curve(
            label=f"{label}, {method}",
            x=tuple(sigma for other, sigma in errors if other == label),
            y=tuple(getattr(each[method], quantity) for (other, _), each in errors.items() if other == label),
        )
        for method in METHODS
        for label in labels
    )
    return StudyFigure(title=title, x_label="noise σ (stripe steps)", y_label=y_label, curves=curves)
