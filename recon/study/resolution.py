"""How fine a relief each method resolves: ripples of 0.05 mm, 2 to 40 pixels long, and a step.

A method that only smoothed would win wherever noise is judged on smooth objects. Here it would lose.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from recon.evaluation.truth import Truth
from recon.geometry.sight import sight_rays
from recon.maps import Maps
from recon.sessions.manifest import CameraBody
from recon.study.experiment import Findings, StudySize, Tell
from recon.study.height_transfer import Edge, Ripples, Transfer, edge_of, height_transfer
from recon.study.noise_rounds import METHODS, reconstructed
from recon.study.noisy_sweeps import TrueSession, load_true_session, noisy_sweeps
from recon.study.simulator import simulated
from recon.study.study_result import Cell, Curve, StudyFigure, StudyTable
from recon.study.wedge_scenes import (
    AMPLITUDE_MM,
    JUDGED_SHARE,
    LEAN_DEG,
    STEP_MM,
    Wedge,
    rippled_wedge,
    stepped_wedge,
)
from recon.surface.integration import integrate_perspective

WAVELENGTHS_PX = (2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 20.0, 40.0)
SIGMAS = (0.1, 0.02)
COLUMNS, ROUNDS = 128, 2
# The least of a ripple this long that must be left.
LIMIT_PX, LIMIT = 6.0, 0.5
# Steeper than this against the sight, a true normal is that of the step's wall or of the wedge's side.
FACE_COSINE = 0.5
SERIES = ("points, paper", "surface, paper", "surface, full")

Points = Float64[np.ndarray, "rows cols 3"]


def resolution(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """Ripples of 2 to 40 pixels and a step of 0.5 mm on a leaning face, with noise on the true correspondences."""
    wedge = Wedge(size.columns_or(COLUMNS))
    rounds = size.rounds_or(ROUNDS)
    rng = np.random.default_rng(size.seed)
    transfers: dict[tuple[float, float], Mapping[str, Transfer]] = {}
    judged_share = {}
    for wavelength_px in WAVELENGTHS_PX:
        scene = rippled_wedge(wedge, wavelength_mm=wavelength_px * wedge.footprint_mm)
        session = _true_session(folder / f"ripples-{wavelength_px:g}", scene)
        face = judged_face(session.truth, wedge)
        judged_share[wavelength_px] = float(face.sum() / within(wedge).sum())
        for sigma in SIGMAS:
            tell(f"ripples of {wavelength_px:g} px, noise of {sigma:g} px")
            seen = [points_by_series(session, sigma, rng) for _ in range(rounds)]
            transfers[sigma, wavelength_px] = {
                name: height_transfer([ripples(points[name], session.truth, face, wedge) for points in seen])
                for name in SERIES
            }
    session = _true_session(folder / "step", stepped_wedge(wedge))
    edges: dict[float, Mapping[str, Edge]] = {}
    for sigma in SIGMAS:
        tell(f"step, noise of {sigma:g} px")
        seen = [points_by_series(session, sigma, rng) for _ in range(rounds)]
        edges[sigma] = {name: step_edge([points[name] for points in seen], session.truth, wedge) for name in SERIES}
    setting = (
        f"A glass wedge of {wedge.side_mm:.0f} mm in water over a tablet; {wedge.columns} × {wedge.columns} camera pixels see "
        f"{wedge.footprint_mm:.3f} mm each of its far face, which leans by {LEAN_DEG:g}°. Ripples have an amplitude of "
        f"{AMPLITUDE_MM:g} mm, the step a height of {STEP_MM:g} mm. Gaussian noise on the true correspondences of all four sets, "
        f"drawn anew in each of {rounds} rounds. Method `paper` has points, and a surface integrated from their normals; method "
        "`full` has one surface."
    )
    return Findings(
        setting, (transfer_table(transfers, judged_share), edge_table(edges)), (transfer_figure(transfers),)
    )


def _true_session(folder: Path, scene: Mapping[str, object]) -> TrueSession:
    return load_true_session(simulated(scene, folder, options=["--truth-only"]))


def points_by_series(session: TrueSession, sigma_px: float, rng: np.random.Generator) -> dict[str, Points]:
    """Return the points that both methods make of the same noisy places; NaN where there are none."""
    sweeps = noisy_sweeps(session, sd_px=sigma_px, rng=rng)
    maps = {method: reconstructed(sweeps, session.manifest, method=method) for method in METHODS}
    return series_of(maps["paper"], maps["full"], session.manifest.camera)


def series_of(paper: Maps, full: Maps, camera: CameraBody) -> dict[str, Points]:
    """Return the three sets of points that are judged."""
    rays = sight_rays(camera)
    assert rays is not None, "a simulated session knows its camera"
    centre, direction = rays
    depth = ((paper.point_mm - centre) * direction).sum(axis=2)
    surface = integrate_perspective(
        paper.normal,
        paper.valid(),
        centre_mm=centre,
        direction=direction,
        anchor_depth_mm=depth,
        integration="discrete",
    )
    points = (_valid_points(paper), surface.point_mm, _valid_points(full))
    return dict(zip(SERIES, points, strict=True))


def _valid_points(maps: Maps) -> Points:
    return np.where(maps.valid()[..., None], maps.point_mm, np.nan)


def within(wedge: Wedge) -> Bool[np.ndarray, "rows cols"]:
    """Return the pixels of the square that is judged."""
    place = np.abs(np.arange(wedge.columns) - (wedge.columns - 1) / 2) * wedge.footprint_mm
    near = place <= JUDGED_SHARE * wedge.side_mm / 2
    return near[:, None] & near


def judged_face(truth: Truth, wedge: Wedge) -> Bool[np.ndarray, "rows cols"]:
    """Return the pixels in that square that truly see the face."""
    return truth.judged & within(wedge) & (truth.normal[..., 2] > FACE_COSINE)


def ripples(point_mm: Points, truth: Truth, face: Bool[np.ndarray, "rows cols"], wedge: Wedge) -> Ripples:
    """Return the heights over the leaning plane, found and true."""
    return Ripples(
        *(np.where(face, wedge.height_mm(each), np.nan) for each in (point_mm, truth.point_mm)),
    )


def step_edge(seen: Sequence[Points], truth: Truth, wedge: Wedge) -> Edge:
    """Return the edge of the step, all rounds together."""
    face = judged_face(truth, wedge)
    offset_px = truth.point_mm[..., 0][face] / wedge.footprint_mm
    found = [wedge.height_mm(point_mm)[face] for point_mm in seen]
    return edge_of(np.tile(offset_px, len(found)), np.concatenate(found), step_mm=STEP_MM)


def transfer_table(
    transfers: Mapping[tuple[float, float], Mapping[str, Transfer]], judged_share: Mapping[float, float]
) -> StudyTable:
    """Return one row a noise and wavelength."""
    rows: list[tuple[Cell, ...]] = []
    for (sigma, wavelength_px), each in sorted(transfers.items(), key=lambda item: (-item[0][0], item[0][1])):
        figures = [figure for name in SERIES for figure in (each[name].ratio, each[name].sd)]
        rows.append((sigma, wavelength_px, *figures, 100 * judged_share[wavelength_px]))
    headings = ("σ (px)", "wavelength (px)", *(word for name in SERIES for word in (name, "sd")), "lit (%)")
    note = (
        f"At {LIMIT_PX:g} px, {LIMIT:g} must be left. Chords at right angles to the mean of two normals leave (π/N) cot(π/N) "
        "of a gentle ripple of N pixels: 0.91 at 6, 0.79 at 4, nothing at 2. Lit: pixels of the square with light in all "
        "four sets."
    )
    return StudyTable(title="Height found over true height", headings=headings, rows=tuple(rows), note=note)


def edge_table(edges: Mapping[float, Mapping[str, Edge]]) -> StudyTable:
    """Return one row a noise and series."""
    rows = tuple(
        (sigma, name, each[name].ratio, each[name].width_px, 100 * each[name].overshoot)
        for sigma, each in edges.items()
        for name in SERIES
    )
    headings = ("σ (px)", "series", "height found / true", "10 to 90 % (px)", "overshoot (%)")
    note = "Heights averaged over all rows in bins of a quarter of a pixel; a dash where there is no step to be found."
    return StudyTable(title=f"A step of {STEP_MM:g} mm", headings=headings, rows=rows, note=note)


def transfer_figure(transfers: Mapping[tuple[float, float], Mapping[str, Transfer]]) -> StudyFigure:
    """Return the transfer over wavelength, with the limit."""
    curves = []
    for sigma in dict.fromkeys(sigma for sigma, _ in transfers):
        own = {wavelength_px: each for (other, wavelength_px), each in transfers.items() if other == sigma}
        for name in SERIES:
            curves.append(
                Curve(label=f"σ = {sigma:g}, {name}", x=tuple(own), y=tuple(each[name].ratio for each in own.values()))
            )
    return StudyFigure(
        title="Height transfer",
        x_label="wavelength (camera pixels)",
        y_label="height found / true",
        curves=tuple(curves),
        y_scale="linear",
        x_scale="log",
        x_lines=(LIMIT_PX,),
        y_lines=(LIMIT,),
    )
