"""How well normals alone give a surface, by each form of integration, on surfaces known in closed form; and what it costs."""

import time
from pathlib import Path

import numpy as np

from recon.study.experiment import Findings, StudySize, Tell
from recon.study.study_result import Cell, Curve, StudyFigure, StudyTable
from recon.study.thin_forms import thin_forms
from recon.study.true_surfaces import SURFACES, View, seen_in_parallel, seen_in_perspective, with_noise
from recon.surface.integration import Integration, integrate_orthographic, integrate_perspective

FORMS: tuple[Integration, ...] = ("quadratic", "discrete", "bilateral")
VIEWS = {"parallel": seen_in_parallel, "perspective": seen_in_perspective}
NOISES_DEG = (0.0, 1.0)
COLUMNS = 128
# What is timed: a smooth surface, up to a megapixel, and one that jumps, whose rounds of bilateral weights are many.
TIMED = {"hills": (1, 2, 4, 8), "cut sheet": (1,)}
TIMED_NOISE_DEG = 1.0
# Objects of 100 mm, as those of DiLiGenT are about.
HALF_SIDE_MM = 50.0
# Nine measured objects (Shi et al. 2016), in perspective; mean absolute depth error, and seconds a megapixel.
PUBLISHED = (
    ("quadratic, multigrid", 1.502, 16.0),
    ("bilateral (Cao et al. 2022)", 1.504, 95.0),
)


def integration(folder: Path, size: StudySize, tell: Tell) -> Findings:
    """Closed-form surfaces, in parallel and in perspective, with and without noise on the normals; then size and time."""
    columns = size.columns_or(COLUMNS)
    rng = np.random.default_rng(size.seed)
    rows: list[tuple[Cell, ...]] = []
    for projection, seen in VIEWS.items():
        for surface in SURFACES:
            for noise_deg in NOISES_DEG:
                tell(f"{surface.name}, {projection}, noise of {noise_deg:g}°")
                view = with_noise(seen(surface, columns), sd_rad=np.radians(noise_deg), rng=rng)
                rows.append((surface.name, projection, noise_deg, *(depth_error_mm(view, form) for form in FORMS)))
    timed, curves = timings(columns, rng, tell)
    setting = (
        f"Depth from normals alone, {columns} × {columns} pixels over 100 mm, the constant set by the median. Normals are "
        "those of the closed form, with Gaussian noise on both tilts."
    )
    accuracy = StudyTable(
        title="Mean absolute depth error (mm)",
        headings=("surface", "seen in", "noise (°)", *FORMS),
        rows=tuple(rows),
        note="The cut sheet's two sides part along half a line: depth jumps there by up to 25 mm.",
    )
    published = StudyTable(
        title="Published, on another data set: DiLiGenT",
        headings=("form", "mean absolute depth error (mm)", "seconds a megapixel"),
        rows=PUBLISHED,
        note="Nine measured objects; their errors are not to be compared with those of closed forms, their times roughly.",
    )
    figure = StudyFigure(
        title="Time",
        x_label="pixels (millions)",
        y_label="processor seconds a megapixel",
        curves=curves,
        y_scale="linear",
        x_scale="log",
    )
    thin = thin_forms(folder, columns, rng, tell)
    return Findings(setting, (accuracy, timed, published, thin), (figure,))


def depth_error_mm(view: View, form: Integration) -> float:
    """Return the mean absolute error of depth over the pixels that see the surface."""
    if np.any(view.origin):
        found = integrate_orthographic(
            view.normal,
            view.mask,
            origin_mm=view.origin,
            direction=np.array([0.0, 0.0, 1.0]),
            anchor_depth_mm=view.depth,
            integration=form,
        )
    else:
        found = integrate_perspective(
            view.normal,
            view.mask,
            centre_mm=np.zeros(3),
            direction=view.direction,
            anchor_depth_mm=view.depth,
            integration=form,
        )
    return float(HALF_SIDE_MM * np.nanmean(np.abs(found.depth_mm - view.depth)[view.mask]))


def timings(columns: int, rng: np.random.Generator, tell: Tell) -> tuple[StudyTable, tuple[Curve, ...]]:
    """Integrate two surfaces at growing size, and return errors and processor time."""
    rows: list[tuple[Cell, ...]] = []
    curves = []
    for surface in SURFACES:
        sizes = [columns * factor for factor in TIMED.get(surface.name, ())]
        megapixels = tuple(size**2 / 1e6 for size in sizes)
        spent_s: dict[Integration, list[float]] = {form: [] for form in FORMS}
        for size, millions in zip(sizes, megapixels, strict=True):
            view = with_noise(seen_in_parallel(surface, size), sd_rad=np.radians(TIMED_NOISE_DEG), rng=rng)
            for form in FORMS:
                tell(f"{surface.name}, {size} × {size} pixels: {form}")
                begun_s = time.process_time()
                error_mm = depth_error_mm(view, form)
                spent_s[form].append((time.process_time() - begun_s) / millions)
                rows.append((surface.name, size, millions, form, error_mm, spent_s[form][-1]))
        if len(sizes) > 1:
            curves += [Curve(label=f"{form} ({surface.name})", x=megapixels, y=tuple(spent_s[form])) for form in FORMS]
    table = StudyTable(
        title="Size and time",
        headings=("surface", "columns", "megapixels", "form", "error (mm)", "processor seconds a megapixel"),
        rows=tuple(rows),
        note=f"Seen in parallel, noise of {TIMED_NOISE_DEG:g}° on both tilts. Processor time of all threads.",
    )
    return table, tuple(curves)
